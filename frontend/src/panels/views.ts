// Views that were kept: bookmarks under the keys 1 to 9, in an order that can be a film's keyframes.

import { tableOf, viewFrom, type View } from "../camera";
import { NAMES } from "../orientation";
import type { Panel, Parts } from "../parts";
import { button, h, refill } from "../ui/dom";
import { pretty } from "../ui/format";
import { add, sub, times } from "../vec";
import type { Table } from "../wire";
import { filmMaker } from "./film";

export interface Views extends Panel {
  go(number: number): void;
  keep(number: number): void;
}

const FLIGHT_MS = 450;

/** As the document has them. */
interface Kept {
  key: number;
  camera: Table;
}

export function viewsPanel({ stage, store, server, notices, navigation }: Pick<Parts, "stage" | "store" | "server" | "notices" | "navigation">): Views {
  // Pictures stay here: the document has cameras only.
  const pictures = new Map<string, string>();
  let shown = "";
  const list = h("ol", { class: "vlm-views" });
  const film = filmMaker({ stage, store, server, notices }, () => kept().map((one) => one.camera));

  const kept = (): Kept[] => store.document.bookmarks ?? [];
  const put = (list: Kept[], label: string) => store.set([["bookmarks", list]], label);

  function keep(key: number): void {
    const { view } = stage;
    if (!view) return;
    const one = { key, camera: tableOf(view) };
    pictures.set(JSON.stringify(one), thumbnail());
    put([...kept().filter((k) => k.key !== key), one].sort((a, b) => a.key - b.key), "keep a view");
    notices.add(`View kept as ${key}: press ${key} to come back`, "info");
    draw();
  }

  function thumbnail(): string {
    const { canvas } = stage;
    const small = h("canvas", { width: 96, height: Math.round(96 / stage.aspect) });
    small.getContext("2d")!.drawImage(canvas, 0, 0, small.width, small.height);
    return small.toDataURL("image/jpeg", 0.8);
  }

  function go(key: number): void {
    const found = kept().find((k) => k.key === key);
    if (!found) return notices.add(`No view is kept as ${key}; Shift ${key} keeps one`, "info");
    fly(viewFrom(found.camera));
  }

  /** Turn and move there smoothly, so that it is seen where "there" is. */
  function fly(to: View): void {
    const from = stage.view;
    if (!from || from.type !== to.type || matchMedia("(prefers-reduced-motion: reduce)").matches) return navigation.look(to, false);
    const start = performance.now();
    const step = () => {
      const t = Math.min(1, (performance.now() - start) / FLIGHT_MS);
      navigation.look(t < 1 ? between_(from, to, t * t * (3 - 2 * t)) : to, t < 1);
      if (t < 1) requestAnimationFrame(step);
    };
    step();
  }

  async function copy(): Promise<void> {
    const reply = await server.tried("export", { what: "keyframes", cameras: kept().map((one) => one.camera), frames: film.wish.frames }, "error");
    if (reply) await notices.copy(reply.text, "Keyframes");
  }

  function row(one: Kept): HTMLElement {
    const { incl, phi } = viewFrom(one.camera);
    const picture = pictures.get(JSON.stringify(one));
    return h(
      "li", {},
      h("button", { type: "button", class: "vlm-view", title: `Go there  (${one.key})`, onclick: () => go(one.key) },
        picture ? h("img", { src: picture, alt: "" }) : null,
        h("kbd", {}, String(one.key)),
        h("span", {}, `incl ${pretty(incl)}°, phi ${pretty(phi)}°`)),
      button("×", `Forget view ${one.key}`, () => put(kept().filter((k) => k.key !== one.key), "forget a view")),
    );
  }

  function draw(): void {
    film.update();
    const key = JSON.stringify(kept());
    if (key === shown) return;
    shown = key;
    const rows = kept().map(row);
    refill(list, ...(rows.length ? rows : [h("li", { class: "vlm-hint" }, "None yet. Shift and a digit, or the button, keep what is on the screen.")]));
  }

  const next = () => [1, 2, 3, 4, 5, 6, 7, 8, 9].find((n) => !kept().some((k) => k.key === n)) ?? 9;
  const sides = h("div", { class: "vlm-actions vlm-sides" });
  /** Buttons for the sides of a patient, and for a stack of pictures; where neither is known, for the axes. */
  function drawSides(): void {
    const names = Object.keys(server.info?.views ?? {});
    const patient = names.includes("anterior");
    const letter = (name: string) => Object.keys(NAMES).find((key) => NAMES[key] === name);
    const ends = patient ? [] : [..."xXyYzZ"].map((axis) => button(`${axis === axis.toLowerCase() ? "+" : "−"}${axis.toLowerCase()}`, `Look from there  (${axis})`, () => navigation.side(axis)));
    refill(sides, ...names.map((name) => button(name, `Look from ${name}${letter(name) ? `  (${letter(name)})` : ""}`, () => navigation.side(name))), ...ends);
  }
  return {
    element: h(
      "div", {},
      h("h2", {}, "Look from"), sides,
      h("h2", {}, "Kept views"), list,
      h("div", { class: "vlm-actions" }, button("Keep this view", "Under the next free digit", () => keep(next()), "plus")),
      h("h2", {}, "Film"), film.element,
      h("div", { class: "vlm-actions" }, button("Copy as Python", "The kept views as keyframes of voluminous.movie", () => void copy(), "copy")),
    ),
    update: draw,
    shown: drawSides,
    go,
    keep,
  };
}

/** Between two views of one type: angles the short way, sizes by equal factors. */
function between_(a: View, b: View, t: number): View {
  const mix = (x: number, y: number) => x + t * (y - x);
  const angle = (x: number, y: number) => x + t * (y - x - 360 * Math.round((y - x) / 360));
  const factor = (x: number, y: number) => x * (y / x) ** t;
  return {
    ...b,
    center: add(a.center, times(sub(b.center, a.center), t)),
    incl: mix(a.incl, b.incl), phi: angle(a.phi, b.phi), posang: angle(a.posang, b.posang),
    width: factor(a.width, b.width), distance: factor(a.distance, b.distance),
  };
}
