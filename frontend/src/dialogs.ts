// Windows above everything: the list of keys, saving, and the history of changes.

import { dressFields, dressOf, estimator, isOnBlack, PLAIN } from "./dress";
import type { Row } from "./keys";
import type { Mark } from "./marks";
import type { Parts } from "./parts";
import type { Store } from "./store";
import { button, h, refill } from "./ui/dom";
import { complain, Form } from "./ui/fields";
import { fromBase64, type Table } from "./wire";

interface Dialog {
  element: HTMLDialogElement;
  open(): void;
}

function dialog(title: string, ...content: HTMLElement[]): Dialog {
  const element = h("dialog", { class: "vlm-dialog", "aria-label": title });
  const close = () => element.close();
  element.append(h("header", {}, h("h2", {}, title), button("×", "Close", close)), ...content);
  // A click beside the window closes it.
  element.addEventListener("click", (event) => event.target === element && close());
  return { element, open: () => element.open || element.showModal() };
}

const GESTURES: [string, string][] = [
  ["drag", "rotate"],
  ["Shift-drag, right button", "move"],
  ["Ctrl-drag", "roll"],
  ["wheel", "zoom to the pointer"],
  ["click", "what this ray saw"],
  ["double click", "rotate about what is there"],
  ["one finger, two fingers", "rotate; move and zoom"],
];

export function helpDialog(keys: Record<string, Row[]>): Dialog {
  const list = (title: string, rows: [string, string][]) =>
    h("section", {}, h("h3", {}, title), h("dl", {}, ...rows.flatMap(([shown, words]) => [h("dt", {}, h("kbd", {}, shown)), h("dd", {}, words)])));
  const sections = Object.entries(keys).map(([group, rows]) => list(group, rows.filter(([, shown]) => shown).map(([, shown, words]) => [shown, words])));
  return dialog("Keys and gestures", h("div", { class: "vlm-help" }, list("Mouse and fingers", GESTURES), ...sections));
}

/** Hand bytes to the browser as a file. */
export function download(name: string, mime: string, data: Uint8Array | string): void {
  const address = URL.createObjectURL(new Blob([data as BlobPart], { type: mime }));
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

/** A bar for something that takes time, and the way to have the file that comes of it. */
export function fileMaker({ server, notices }: Pick<Parts, "server" | "notices">): { bar: HTMLProgressElement; make(kind: string, what: Table): Promise<boolean>; cancel(): void } {
  const bar = h("progress", { max: 1, value: 0, hidden: true, "aria-label": "progress" });
  let id = 0;
  return {
    bar,
    async make(kind, what) {
      Object.assign(bar, { hidden: false, value: 0 });
      complain(bar, "");
      try {
        const answer = server.ask(kind, what, (part) => (bar.value = part));
        id = answer.id;
        const reply = await answer;
        download(reply.name, reply.mime, reply.text ?? fromBase64(reply.data));
        return true;
      } catch (error) {
        const { message } = error as Error;
        // What is wrong begins with the name of what was given: "width must be …".
        const named = [...bar.parentElement!.querySelectorAll("input")].find((input) => input.labels?.[0]?.textContent?.toLowerCase() === message.split(" ")[0]);
        if (message === "cancelled") notices.add(message);
        else complain(named ?? bar, message);
        return false;
      } finally {
        bar.hidden = true;
      }
    },
    cancel: () => server.send({ kind: "cancel", of: id }),
  };
}

const KINDS: Record<string, string> = {
  "PNG, as shown": "png",
  "FITS, intensities": "fits",
  "OpenEXR, intensities": "exr",
  "Scene (TOML)": "toml",
  "Python script": "python",
};

/** @param marks the lines of the measures */
export function saveDialog(parts: Pick<Parts, "stage" | "store" | "server" | "notices">, marks: () => Mark[]): Dialog {
  const wish = { format: "PNG, as shown", width: 2000, ...PLAIN };
  let ready = false;
  const maker = fileMaker(parts);
  const form = new Form<typeof wish>();
  const put = (what: Partial<typeof wish>) => {
    form.update(Object.assign(wish, what));
    if (ready) tell();
  };
  const isText = () => /TOML|Python/.test(wish.format);
  const has: Record<string, () => unknown> = { letters: () => parts.server.info?.orientation, measures: () => parts.store.document.measures?.length };
  const may = (name: string) => KINDS[wish.format] === "png" && !isOnBlack(parts.store, name) && Boolean(has[name]?.() ?? !has[name]);
  const ask = () => ({ what: KINDS[wish.format], ...dressOf(wish, may) });
  const estimate = estimator(parts.server);
  const tell = () => void estimate.show(isText() ? null : ask(), wish.width ** 2 / parts.stage.aspect);
  const save = async () => {
    const more = isText() ? {} : { width: wish.width, measures: marks().map(({ points, words }) => [points, words]) };
    if (await maker.make("export", { ...ask(), ...more })) made.element.close();
  };
  const screen = () =>
    parts.stage.canvas.toBlob(async (blob) => {
      if (blob) download("screen.png", "image/png", new Uint8Array(await blob.arrayBuffer()));
    });
  const main = button("Save", "Save", () => void save(), "save");
  main.classList.add("vlm-primary");
  const made: Dialog = dialog(
    "Save",
    form.choice((now) => now.format, "Format", () => Object.keys(KINDS), (format) => put({ format })),
    form.number((now) => (isText() ? undefined : now.width), "Width", "pixels", (width) => put({ width: Math.max(1, Math.round(width)) })),
    dressFields(form, put, may), estimate.element, maker.bar,
    h("p", { class: "vlm-hint" }, "Drawn anew by the server at this width, with the scene in the header. What is on the screen is saved at once, as it is."),
    h("div", { class: "vlm-actions" }, button("Screen as PNG", "Save what is seen, without asking the server", screen), main),
  );
  put({});
  return {
    element: made.element,
    open() {
      ready = true;
      made.open();
      estimate.forget();
      put({}); // what may be in the picture depends on the volume, and on what was measured
    },
  };
}

/** Undo, redo, and a list of all changes: a click goes back to before one of them. */
export function historyMenu(store: Store): { element: HTMLElement; update(): void } {
  const undo = button("", "Undo  (Ctrl Z)", () => store.goBack(), "undo");
  const redo = button("", "Redo  (Ctrl Y)", () => store.goForth(), "redo");
  const list = h("ol", { class: "vlm-history" });
  const menu = h("details", { class: "vlm-menu" }, h("summary", { title: "History", "aria-label": "History" }, "▾"), list);
  menu.addEventListener("focusout", (event) => {
    if (!menu.contains(event.relatedTarget as Node)) menu.open = false;
  });
  let shown = "";
  const entry = (words: string, title: string, state: string, act: () => void) =>
    h("li", { class: state }, button(words, title, act));
  return {
    element: h("div", { class: "vlm-undo" }, undo, redo, menu),
    update() {
      const past = store.undo;
      const future = store.redo;
      undo.disabled = !past.length;
      redo.disabled = !future.length;
      undo.title = past.length ? `Undo: ${past[past.length - 1]}  (Ctrl Z)` : "Nothing to undo";
      const key = JSON.stringify([past, future]);
      if (key === shown) return;
      shown = key;
      refill(
        list,
        ...past.map((words, i) => entry(words, "Undo this and what came after", "", () => store.goBack(past.length - i))),
        h("li", { class: "vlm-now" }, past.length || future.length ? "now" : "nothing was changed yet"),
        ...[...future].reverse().map((words, i) => entry(words, "Do it again", "vlm-undone", () => store.goForth(i + 1))),
      );
    },
  };
}
