// The list of media, the histogram above it, and all numbers of the chosen one.

import { colorFor, fresh, kindOf, NAMES, strengthOf, titleOf, totals, TYPES } from "../media";
import type { Panel, Parts } from "../parts";
import { gradient, SAFE, stripes, vivid } from "../ui/color";
import { button, h, icon, refill } from "../ui/dom";
import { toggle } from "../ui/fields";
import { perLength, pretty } from "../ui/format";
import type { Message, Table } from "../wire";
import { coefficientCurves, Plot } from "../ui/lines";
import { mediumEditor } from "./editor";
import { Histogram } from "./histogram";

const BINS = 160;
const RATIO_FOR_LOG = 100;
/** How often it is looked whether a preset's picture is there, and for how long. */
const WAIT_MS = 50;
const MOST_WAITS = 1200;

export function mediaPanel(parts: Pick<Parts, "stage" | "store" | "server" | "highlight">): Panel {
  const { stage, store, server } = parts;
  const known = new Map<string, Message | "asked">();
  let chosen = 0;
  const media = (): Table[] => store.document.medium ?? [];
  const exprOf = (medium: Table | undefined): string => medium?.expr ?? server.info?.fields[0]?.name ?? "";

  const select = (i: number) => {
    chosen = i;
    histogram.chosen = i;
    update();
  };
  const total = new Plot("all media", (x) => readOut(x === null ? null : histogram.fromX(x)));
  const histogram = new Histogram(parts, select, readOut, drawTotal);

  /** The cursor of the plot of all media, and what is there. */
  function readOut(value: number | null): void {
    total.at(value === null ? null : histogram.toX(value), value === null ? "" : pretty(value));
  }

  /** Emission and extinction of all media together, under the histogram. */
  function drawTotal(): void {
    const { values, places } = histogram.across;
    const unit = server.info?.unit ?? "";
    const found = totals(media(), histogram.data?.expr, values, store.open, stage.tables, store.channels, unit);
    const [factor, per] = perLength(unit);
    total.element.hidden = !found;
    if (found) total.show(places, coefficientCurves(found.j, [found.alpha], factor), per || "per length");
  }

  const logarithmic = new Map<string, boolean>();
  const axis = toggle("log axis", (on) => {
    logarithmic.set(exprOf(media()[chosen]), on);
    void load();
  }, "The axis of values, for expressions without a logarithm of their own");

  /** Whether values are drawn logarithmically: by default those of positive fields over decades. */
  function isLog(expr: string): boolean {
    const field = server.info?.fields.find((f) => f.name === expr);
    return logarithmic.get(expr) ?? Boolean(field && field.min > 0 && field.max / field.min > RATIO_FOR_LOG);
  }

  async function load(): Promise<void> {
    const expr = exprOf(media()[chosen]);
    if (!expr || !server.info) return;
    const log = isLog(expr);
    axis.update(log);
    const key = `${store.document.volume?.path ?? ""} ${expr} ${log}`;
    const found = known.get(key);
    if (found === "asked") return;
    if (found) return histogram.show(found);
    known.set(key, "asked");
    const reply = await server.tried("histogram", { expr, bins: BINS, log });
    if (reply) known.set(key, { ...reply, expr });
    else known.delete(key);
    histogram.show(reply && { ...reply, expr });
  }

  const plot = h("div", { class: "vlm-plot" }, histogram.element, total.element);
  const list = h("ul", { class: "vlm-media", "aria-label": "Media" });
  const editor = mediumEditor(parts, () => chosen, histogram);

  const add = (medium: Table, label: string) => {
    store.set([["medium", [...media(), medium]]], label);
    select(media().length - 1);
  };
  const kind = h("select", { "aria-label": "Kind of a new medium" }, ...TYPES.map((type) => h("option", { value: type }, NAMES[type])));
  const presets = presetMenu(parts, () => [plot, list, editor.element], () => select(0));
  const addFresh = () => {
    const expr = exprOf(kind.value === "coefficients" ? undefined : media()[chosen]);
    const [low, high] = histogram.range;
    add(fresh(kind.value, expr, [low, high], null, SAFE[media().length % SAFE.length], store.channels), "add a medium");
  };
  const duplicate = () => {
    const medium = media()[chosen];
    if (medium) add(structuredClone(medium), "duplicate a medium");
  };
  const remove = () => {
    if (!media()[chosen]) return;
    store.set([["medium", media().filter((_, i) => i !== chosen)]], "remove a medium");
    select(Math.max(0, chosen - 1));
  };
  const hide = (i: number) => {
    const hidden = !media()[i].hidden;
    store.set([[`medium.${i}.hidden`, hidden || null]], hidden ? "hide a medium" : "show a medium");
  };

  let rows: HTMLElement[] = [];
  function row(i: number): HTMLElement {
    const eye = h("button", { type: "button", class: "vlm-eye", onclick: () => hide(i) });
    const name = h("button", { type: "button", class: "vlm-pick", onclick: () => select(i) });
    return h("li", {}, name, eye);
  }

  function drawList(): void {
    if (rows.length !== media().length) {
      rows = media().map((_, i) => row(i));
      refill(list, ...(rows.length ? rows : [h("li", { class: "vlm-hint" }, "No media yet: add one, or let one be suggested.")]));
    }
    media().forEach((medium, i) => {
      const [name, eye] = rows[i].children as unknown as HTMLElement[];
      rows[i].classList.toggle("vlm-on", i === chosen);
      rows[i].classList.toggle("vlm-off", Boolean(medium.hidden));
      name.setAttribute("aria-pressed", String(i === chosen));
      const key = JSON.stringify([titleOf(medium), medium.color, medium.colors, medium.type, medium.cmap, medium.hidden, strengthOf(medium)]);
      if (rows[i].dataset.key === key) return;
      rows[i].dataset.key = key;
      const swatch = h("span", { class: "vlm-swatch" });
      swatch.style.background = medium.type === "colormap" ? gradient(stage.tables.get(medium.cmap)) : medium.type === "labels" ? stripes(medium.colors) : vivid(colorFor(medium));
      const tau = medium.type === "coefficients" || medium.type === "labels" ? "" : `τ ${pretty(strengthOf(medium), 2)}`;
      refill(name, swatch, h("span", { class: "vlm-title" }, titleOf(medium)), h("span", { class: "vlm-kind" }, kindOf(medium)), h("span", { class: "vlm-tau" }, tau));
      refill(eye, icon(medium.hidden ? "hidden" : "eye"));
      eye.title = medium.hidden ? "Show" : "Hide";
      eye.setAttribute("aria-label", `${eye.title} ${titleOf(medium)}`);
    });
  }

  function update(): void {
    if (!server.info) return;
    chosen = Math.min(chosen, Math.max(0, media().length - 1));
    histogram.chosen = chosen;
    if (exprOf(media()[chosen]) !== histogram.data?.expr) {
      void load();
    }
    drawList();
    editor.update();
    histogram.draw();
  }

  return {
    element: h(
      "div",
      {},
      plot,
      h("div", { class: "vlm-line" }, axis.element, h("span", { class: "vlm-hint" }, "drag the shapes; Shift: one axis")),
      list,
      h(
        "div",
        { class: "vlm-actions vlm-adding" },
        kind, button("Add", "Add a medium of this kind", addFresh, "plus"), h("span", { class: "vlm-break" }), presets, h("span", { class: "vlm-gap" }),
        button("", "Duplicate the chosen medium", duplicate, "copy"), button("", "Remove the chosen medium", remove, "bin"),
      ),
      editor.element,
    ),
    update,
    shown: () => void load(),
  };
}

/**
 * Presets, each with a small picture of this volume from here; those are asked for when the list opens. What
 * suits the data comes first. A click is taken until its picture is there; meanwhile nothing else is edited.
 */
function presetMenu({ stage, store, server }: Pick<Parts, "stage" | "store" | "server">, edited: () => HTMLElement[], taken: () => void): HTMLElement {
  const list = h("ul", { class: "vlm-presets" });
  const menu = h("details", { class: "vlm-preset-menu" }, h("summary", { title: "Media made for this volume" }, "Presets ▾"), list);
  let busy = false;
  const take = async (name: string | null, one: HTMLElement) => {
    if (busy) return;
    busy = true;
    one.setAttribute("aria-pressed", "true");
    one.setAttribute("aria-busy", "true");
    for (const part of edited()) part.inert = true;
    const done = await server.tried("suggest", { name });
    for (let k = 0; done && k < MOST_WAITS && (stage.head?.revision ?? 0) < done.revision; k++) await new Promise((again) => setTimeout(again, WAIT_MS));
    for (const part of edited()) part.inert = false;
    one.removeAttribute("aria-busy");
    one.setAttribute("aria-pressed", "false");
    busy = false;
    if (!done) return;
    menu.open = false;
    taken();
  };
  const worded = (name: string | null) => (name ?? "suggested").replaceAll("_", " ");
  let others = false;
  let known = "";
  async function fill(): Promise<void> {
    const now = JSON.stringify([stage.view, store.document.volume, others]);
    if (!menu.open || now === known) return;
    known = now;
    const presets: string[] = server.welcome?.presets ?? [];
    const suited = server.welcome?.suited ?? 0;
    const names = [...presets.slice(0, suited), null, ...(others ? presets.slice(suited) : [])];
    const images = names.map(() => h("img", { alt: "" }));
    const more = () => ((others = true), void fill());
    refill(
      list,
      ...names.map((name, i) => h("li", {}, h("button", { type: "button", "aria-pressed": "false", onclick: (event: Event) => void take(name, event.currentTarget as HTMLElement) }, images[i], h("span", {}, worded(name))))),
      !others && suited < presets.length && h("li", {}, button("others …", "Presets for other kinds of data", more)),
    );
    requestAnimationFrame(() => list.scrollIntoView({ block: "nearest" }));
    // One after the other, and none after a click: the server answers in order.
    for (let i = 0; i < names.length && menu.open && !busy && known === now; i++) {
      try {
        const { mime, data } = await server.ask("thumbnail", { name: names[i] });
        images[i].src = `data:${mime};base64,${data}`;
      } catch (error) {
        images[i].closest("button")!.title = (error as Error).message;
      }
      if (i + 1 < names.length && (!menu.open || busy)) known = "";
    }
  }
  menu.addEventListener("toggle", () => void fill());
  menu.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    menu.open = false;
    menu.querySelector("summary")!.focus();
  });
  return menu;
}
