// The scene as text: Python and TOML that make this picture, always of what is on the screen.

import type { Panel, Parts } from "../parts";
import { button, h } from "../ui/dom";
import { complain } from "../ui/fields";

const QUIET_MS = 300;

export function scenePanel({ stage, store, server, scenes, notices }: Pick<Parts, "stage" | "store" | "server" | "scenes" | "notices">): Panel {
  const box = (what: "python" | "toml", label: string, key: string) => {
    const text = h("pre", { tabindex: "0", "aria-label": label });
    const element = h(
      "section", { class: "vlm-code" },
      h("header", {}, h("h2", {}, label), button("Copy", `Copy  (${key})`, () => void scenes.copy(what), "copy")),
      text,
    );
    return { what, text, element };
  };
  const boxes = [box("python", "Python", "c"), box("toml", "Scene file (TOML)", "C")];

  const given = h("textarea", { rows: 3, spellcheck: "false", "aria-label": "Scene file or link", placeholder: "Paste a scene file (TOML) or a link here, or drop a file" });
  const take = (text: string) => {
    notices.field = given;
    complain(given, "");
    scenes.load(text.trim()).then(() => (given.value = ""), (error) => complain(given, error.message));
  };
  const takeFile = (list?: FileList | null) => void list?.[0]?.text().then(take);
  const file = h("input", { type: "file", accept: ".toml", hidden: true, onchange: () => takeFile(file.files) });
  const element = h(
    "div",
    {
      ondragover: (event: DragEvent) => event.preventDefault(),
      ondrop: (event: DragEvent) => {
        if (!event.dataTransfer?.files.length) return;
        event.preventDefault();
        takeFile(event.dataTransfer.files);
      },
    },
    h("h2", {}, "Load a scene"), h("div", {}, given),
    h(
      "div", { class: "vlm-actions" },
      button("Load", "Take media, camera and picture of this scene; the volume stays", () => take(given.value)),
      button("Open a file", "A scene file (TOML)", () => file.click()), file,
      button("Copy link", "A link to this scene, for others who look at this volume  (l)", () => void scenes.copyLink(), "copy"),
    ),
    ...boxes.map((b) => b.element),
    h("p", { class: "vlm-hint" }, "Either makes this picture again, in a script or with: voluminous scene.toml"),
  );
  let revision = "";
  let timer = 0;

  async function load(): Promise<void> {
    for (const { what, text } of boxes) {
      text.textContent = await server.ask("export", { what }).then((reply) => reply.text, (error) => error.message);
    }
  }

  function update(): void {
    const now = JSON.stringify([store.document, stage.view]);
    if (now === revision || !server.welcome) return;
    revision = now;
    clearTimeout(timer);
    timer = window.setTimeout(() => void load(), QUIET_MS);
  }

  return {
    element,
    update,
    shown: () => {
      revision = "";
      update();
    },
  };
}
