// What is said to the user: notices that go away, and words for those who do not see the picture.

import { button, h } from "./ui/dom";
import { complain } from "./ui/fields";

const SHOWN_MS: Record<string, number> = { info: 4000, warning: 9000, error: 20000 };

export class Notices {
  readonly element = h("div", { class: "vlm-notices", role: "log" });
  readonly live = h("div", { class: "vlm-offscreen", "aria-live": "polite" });

  /** The field that is being edited: what is wrong with it is said below it, and nowhere else. */
  field: HTMLElement | null = null;
  private fields = new Map<number, HTMLElement>();

  follow(root: HTMLElement): void {
    for (const kind of ["pointerdown", "click", "keydown", "input", "change"]) {
      root.addEventListener(kind, ({ target }) => {
        this.field = (target as HTMLElement).matches("input, textarea, select") ? (target as HTMLElement) : null;
        if (this.field && (kind === "input" || kind === "change")) complain(this.field, "");
      }, true);
    }
  }

  /** An input with this number comes from that field. */
  remember(n: number): number {
    if (this.field) this.fields.set(n, this.field);
    return n;
  }

  about(n: number | undefined): HTMLElement | null {
    const field = this.fields.get(n ?? -1) ?? null;
    this.fields.delete(n ?? -1);
    return field;
  }

  add(text: string, level = "info", field: HTMLElement | null = null): void {
    if (field?.isConnected && field.offsetParent) return complain(field, text);
    if ([...this.element.children].some((box) => box.firstChild!.textContent === text)) return;
    const box = h("div", { class: `vlm-notice vlm-${level}` }, h("span", {}, text));
    const close = () => box.remove();
    box.append(button("×", "Close", close));
    this.element.append(box);
    setTimeout(close, SHOWN_MS[level] ?? 6000);
  }

  /** Tell those who do not see the picture. */
  announce(text: string): void {
    this.live.textContent = text;
  }

  /** Put text where it can be pasted. */
  async copy(text: string, what: string): Promise<void> {
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // Without a secure context there is only the old way.
      const area = h("textarea", { class: "vlm-offscreen" }, text);
      this.live.after(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    this.add(`${what} copied`);
  }
}
