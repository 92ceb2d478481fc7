// The scene as text: Python and TOML that make this picture, always of what is on the screen.

import type { App } from "../app";
import type { Panel } from "../layout";
import { button, h } from "../ui/dom";

const QUIET_MS = 300;

export function scenePanel(app: App): Panel {
  const box = (what: "python" | "toml", label: string, key: string) => {
    const text = h("pre", { tabindex: "0", "aria-label": label });
    const element = h(
      "section", { class: "vlm-code" },
      h("header", {}, h("h3", {}, label), button("Copy", `Copy  (${key})`, () => void app.copyScene(what), "copy")),
      text,
    );
    return { what, text, element };
  };
  const boxes = [box("python", "Python", "c"), box("toml", "Scene file (TOML)", "C")];
  let revision = "";
  let timer = 0;

  async function load(): Promise<void> {
    for (const { what, text } of boxes) {
      try {
        text.textContent = (await app.ask("export", { what })).text;
      } catch (error) {
        text.textContent = (error as Error).message;
      }
    }
  }

  function update(): void {
    const now = JSON.stringify(app.store.document);
    if (now === revision || !app.welcome) return;
    revision = now;
    clearTimeout(timer);
    timer = window.setTimeout(() => void load(), QUIET_MS);
  }

  return {
    element: h("div", {}, ...boxes.map((b) => b.element), h("p", { class: "vlm-hint" }, "Either makes this picture again, in a script or with: voluminous scene.toml")),
    update,
    shown: () => {
      revision = "";
      update();
    },
  };
}
