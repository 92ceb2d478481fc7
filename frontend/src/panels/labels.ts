// The table of the labels of a segmentation: eye, colour, name and opacity of each.

import type { Parts } from "../parts";
import { colorOf, toHex } from "../ui/color";
import { button, h, icon, refill } from "../ui/dom";
import type { Field } from "../ui/fields";
import type { Table } from "../wire";

/** More labels than these can be searched by name. */
const MANY = 8;

export function labelTable({ store }: Pick<Parts, "store">, index: () => number): Field<Table> {
  const list = h("ul", { class: "vlm-labels", "aria-label": "Labels" });
  const find = h("input", { type: "search", placeholder: "Find a label", "aria-label": "Find a label", oninput: narrow });
  const now = (): Table => store.document.medium?.[index()] ?? {};
  const set = (name: string, value: any, label: string, moving = false) => store.set([[`medium.${index()}.${name}`, value]], label, moving);
  const showAll = (on: boolean) => set("visible", now().numbers.map(() => on), on ? "show all labels" : "hide all labels");
  let rows: HTMLElement[] = [];

  function row(k: number): HTMLElement {
    const eye = h("button", { type: "button", class: "vlm-eye", onclick: () => set(`visible.${k}`, !now().visible[k], now().visible[k] ? "hide a label" : "show a label") });
    const paint = (moving: boolean) => set(`colors.${k}`, colorOf(color.value).map((v) => Number(v.toFixed(4))), "colour of a label", moving);
    const color = h("input", { type: "color", class: "vlm-color", oninput: () => paint(true), onchange: () => paint(false) });
    const name = h("input", { type: "text", class: "vlm-label-name", spellcheck: "false", autocomplete: "off", onchange: () => set(`labels.${k}`, name.value.trim() || String(now().numbers[k]), "name of a label") });
    const fade = (moving: boolean) => set(`opacities.${k}`, Number(opacity.value), "opacity of a label", moving);
    const opacity = h("input", { type: "range", min: 0, max: 1, step: 0.01, oninput: () => fade(true), onchange: () => fade(false) });
    return h("li", {}, eye, color, name, opacity);
  }

  function narrow(): void {
    const text = find.value.trim().toLowerCase();
    rows.forEach((one, k) => (one.hidden = !`${now().numbers[k]} ${now().labels[k]}`.toLowerCase().includes(text)));
  }

  return {
    element: h(
      "div", {},
      h("div", { class: "vlm-actions" }, button("Show all", "Show all labels", () => showAll(true), "eye"), button("Hide all", "Hide all labels", () => showAll(false), "hidden"), find),
      list,
    ),
    update(medium) {
      const { numbers = [], labels = [], colors = [], opacities = [], visible = [] } = medium;
      find.hidden = numbers.length <= MANY;
      if (rows.length !== numbers.length) {
        rows = numbers.map((_: number, k: number) => row(k));
        refill(list, ...rows);
      }
      rows.forEach((one, k) => {
        const key = JSON.stringify([numbers[k], labels[k], colors[k], opacities[k], visible[k]]);
        if (one.dataset.key === key) return;
        one.dataset.key = key;
        const [eye, color, name, opacity] = one.children as unknown as [HTMLElement, HTMLInputElement, HTMLInputElement, HTMLInputElement];
        one.classList.toggle("vlm-unseen", !visible[k]);
        one.title = `${labels[k]}: label ${numbers[k]}`;
        refill(eye, icon(visible[k] ? "eye" : "hidden"));
        eye.setAttribute("aria-label", `${visible[k] ? "Hide" : "Show"} ${labels[k]}`);
        for (const [input, value, what] of [[color, toHex(colorOf(colors[k])), "colour"], [name, labels[k], "name"], [opacity, String(opacities[k]), "opacity"]] as const) {
          if (!input.matches(":active") && !(input === name && input.matches(":focus"))) input.value = value;
          input.setAttribute("aria-label", `${what} of ${labels[k]}`);
        }
      });
      narrow();
    },
  };
}
