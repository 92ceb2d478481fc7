// The list of media, the histogram above it, and all numbers of the chosen one.

import type { App } from "../app";
import type { Panel } from "../layout";
import { absorbed, canLock, colorFor, fresh, given, isShell, kindOf, NAMES, strengthened, strengthOf, STRONGEST, titleOf, totals, TYPES, WEAKEST, widthName } from "../media";
import { colorOf, SAFE, vivid } from "../ui/color";
import { button, h, icon, refill } from "../ui/dom";
import { Form, labelled, numberField, toggle } from "../ui/fields";
import { likewise, numberOf, pretty, prettyUnit, suited, unitOf } from "../ui/format";
import type { Message, Table } from "../wire";
import { coefficientCurves, Plot } from "../ui/lines";
import { Histogram } from "./histogram";

const BINS = 160;
const RATIO_FOR_LOG = 100;

export function mediaPanel(app: App): Panel {
  const { store } = app;
  const known = new Map<string, Message | "asked">();
  let chosen = 0;
  const media = (): Table[] => store.document.medium ?? [];
  const exprOf = (medium: Table | undefined): string => medium?.expr ?? app.info?.fields[0]?.name ?? "";

  const select = (i: number) => {
    chosen = i;
    histogram.chosen = i;
    update();
  };
  const total = new Plot("all media", (x) => readOut(x === null ? null : histogram.fromX(x)));
  const histogram = new Histogram(app, select, readOut, drawTotal);

  /** The cursor of the plot of all media, and what is there. */
  function readOut(value: number | null): void {
    total.at(value === null ? null : histogram.toX(value), value === null ? "" : pretty(value));
  }

  /** Emission and extinction of all media together, under the histogram. */
  function drawTotal(): void {
    const { values, places } = histogram.across;
    const unit = app.info?.unit ?? "";
    const found = totals(media(), histogram.data?.expr, values, store.open, app.stage.tables, store.channels, unit);
    total.element.hidden = !found;
    if (found) total.show(places, coefficientCurves(found.j, [found.alpha]), unit ? prettyUnit(`1 / ${unit}`) : "per length");
  }

  const logarithmic = new Map<string, boolean>();
  const axis = toggle("log axis", (on) => {
    logarithmic.set(exprOf(media()[chosen]), on);
    void load();
  }, "The axis of values, for expressions without a logarithm of their own");

  /** Whether values are drawn logarithmically: by default those of positive fields over decades. */
  function isLog(expr: string): boolean {
    const field = app.info?.fields.find((f) => f.name === expr);
    return logarithmic.get(expr) ?? Boolean(field && field.min > 0 && field.max / field.min > RATIO_FOR_LOG);
  }

  async function load(): Promise<void> {
    const expr = exprOf(media()[chosen]);
    if (!expr || !app.info) return;
    const log = isLog(expr);
    axis.update(log);
    const key = `${store.document.volume?.path ?? ""} ${expr} ${log}`;
    const found = known.get(key);
    if (found === "asked") return;
    if (found) return histogram.show(found);
    known.set(key, "asked");
    const reply = await app.tried("histogram", { expr, bins: BINS, log });
    if (reply) known.set(key, { ...reply, expr });
    else known.delete(key);
    histogram.show(reply && { ...reply, expr });
  }

  const list = h("ul", { class: "vlm-media", "aria-label": "Media" });
  const editor = mediumEditor(app, () => chosen, histogram);

  const add = (medium: Table, label: string) => {
    store.set([["medium", [...media(), medium]]], label);
    select(media().length - 1);
  };
  const kind = h("select", { "aria-label": "Kind of a new medium" }, ...TYPES.map((type) => h("option", { value: type }, NAMES[type])));
  const presets = presetMenu(app, () => select(0));
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
      const key = JSON.stringify([titleOf(medium), medium.color, medium.type, medium.cmap, medium.hidden, strengthOf(medium)]);
      if (rows[i].dataset.key === key) return;
      rows[i].dataset.key = key;
      const swatch = h("span", { class: "vlm-swatch" });
      swatch.style.background = medium.type === "colormap" ? gradient(app, medium.cmap) : vivid(colorFor(medium));
      const tau = medium.type === "coefficients" ? "" : `τ ${pretty(strengthOf(medium), 2)}`;
      refill(name, swatch, h("span", { class: "vlm-title" }, titleOf(medium)), h("span", { class: "vlm-kind" }, kindOf(medium)), h("span", { class: "vlm-tau" }, tau));
      refill(eye, icon(medium.hidden ? "hidden" : "eye"));
      eye.title = medium.hidden ? "Show" : "Hide";
      eye.setAttribute("aria-label", `${eye.title} ${titleOf(medium)}`);
    });
  }

  function update(): void {
    if (!app.info) return;
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
      h("div", { class: "vlm-plot" }, histogram.element, total.element),
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

/** Presets, each with a small picture of this volume from here; those are asked for when the list opens. */
function presetMenu(app: App, taken: () => void): HTMLElement {
  const list = h("ul", { class: "vlm-presets" });
  const menu = h("details", { class: "vlm-preset-menu" }, h("summary", { title: "Media made for this volume" }, "Presets ▾"), list);
  const take = (name: string | null) => {
    menu.open = false;
    void app.tried("suggest", { name }).then((done) => done && taken());
  };
  let known = "";
  menu.addEventListener("toggle", async () => {
    const now = JSON.stringify([app.store.document.camera, app.store.document.volume]);
    if (!menu.open || now === known) return;
    known = now;
    requestAnimationFrame(() => list.scrollIntoView({ block: "nearest" }));
    const names: (string | null)[] = [null, ...(app.welcome?.presets ?? [])];
    const images = names.map(() => h("img", { alt: "" }));
    refill(list, ...names.map((name, i) => h("li", {}, h("button", { type: "button", onclick: () => take(name) }, images[i], h("span", {}, (name ?? "suggested").replaceAll("_", " "))))));
    // One after the other, and none after a click: the server answers in order.
    for (let i = 0; i < names.length && menu.open && known === now; i++) {
      try {
        const { mime, data } = await app.ask("thumbnail", { name: names[i] });
        images[i].src = `data:${mime};base64,${data}`;
      } catch (error) {
        images[i].closest("button")!.title = (error as Error).message;
      }
      if (i + 1 < names.length && !menu.open) known = "";
    }
  });
  menu.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    menu.open = false;
    menu.querySelector("summary")!.focus();
  });
  return menu;
}

/** A colormap as a background of CSS. */
export function gradient(app: App, cmap: string): string {
  const table = app.stage.tables.get(cmap);
  if (!table) return "linear-gradient(90deg, #222, #eee)";
  const stops = [...Array(13).keys()].map((k) => {
    const i = 3 * Math.round((k / 12) * 255);
    return `rgb(${table[i]},${table[i + 1]},${table[i + 2]})`;
  });
  return `linear-gradient(90deg, ${stops.join(",")})`;
}

/** Fields of all numbers of one medium; made anew when another kind of medium is chosen. */
function mediumEditor(app: App, index: () => number, histogram: Histogram) {
  const element = h("div", { class: "vlm-editor" });
  const { store } = app;
  let shown = "";
  let form = new Form<Table>();
  const medium = (): Table | undefined => store.document.medium?.[index()];
  const set = (name: string, value: any, label: string, moving = false) => store.set([[`medium.${index()}.${name}`, value]], label, moving);
  const maps = () => [...app.stage.tables.keys()].sort();

  function quantity(label: string, name: string, hint?: string): HTMLElement {
    const field = numberField(label, "", (value) => set(name, likewise(medium()?.[name], value), label), hint);
    return form.add<Table>({
      element: field.element,
      update(m) {
        const value = given(m, name, store.open, index());
        field.update(value);
        const unit = prettyUnit(unitOf(m[name]) || histogram.data?.unit);
        field.unit.textContent = m[name] === undefined && value !== null ? `${unit} auto` : unit;
      },
    }, (m) => m);
  }

  const text = (label: string, name: string, hint?: string, placeholder = "") =>
    form.text(({ [name]: value = "" }) => (typeof value === "object" ? JSON.stringify(value) : String(value)), label, (value) => set(name, listed(value) || null, label), hint, placeholder);

  function strength(): HTMLElement[] {
    const put = (tau: number, moving = false) => tau >= 0 && store.set(strengthened(medium()!, index(), tau, histogram.locked), "strength", moving);
    // A length of the medium, and the optical depth of it, come to the way that light goes in it.
    const way = (m: Table): [number, string] | null => {
      const length = m.type === "isosurface" ? null : given(m, "path_length", store.open, index());
      return length && strengthOf(m) > 0 ? suited(length / strengthOf(m), unitOf(m.path_length) || app.info?.unit || "") : null;
    };
    const free = numberField("Mean free path", "", (value) => value > 0 && put((strengthOf(medium()!) * way(medium()!)![0]) / value), "How far light goes in it, where it is densest");
    const told = h("p", { class: "vlm-hint vlm-readout" });
    return [
      form.slider((m) => Math.log10(Math.max(strengthOf(m), 10 ** WEAKEST)), "Strength", [WEAKEST, STRONGEST, 0.02], (v) => `τ ${pretty(10 ** v, 2)}`, (v, moving) => put(10 ** v, moving), "Optical depth of one crossing"),
      form.number((m) => Number(strengthOf(m).toPrecision(4)), "τ per crossing", "", put),
      form.add<[number, string]>({ element: free.element, update: ([value, unit]) => (free.update(Number(value.toPrecision(4))), (free.unit.textContent = prettyUnit(unit))) }, (m) => way(m) ?? undefined),
      form.add<Table>({ element: told, update: (m) => void (told.textContent = absorbed(strengthOf(m))) }, (m) => m),
      form.toggle((m) => (canLock(m) ? histogram.locked : undefined), "glow follows strength (S = j/α kept)", (on) => (histogram.locked = on), "Off: emission stays while extinction changes"),
    ];
  }

  /** One colour, or those of a colormap at another expression. */
  function color(name: "color" | "colors"): HTMLElement[] {
    const by = (m: Table): Table | undefined => (m[name] && typeof m[name] === "object" && !Array.isArray(m[name]) ? m[name] : undefined);
    const plain = (m: Table) => name === "color" && !by(m) && [m.color ?? 1].flat(Infinity).length <= 3;
    const now = (): any => medium()?.color ?? [1, 1, 1];
    const brightest = (value: any) => Math.max(...colorOf(value)) || 1;
    const put = (hex: string, moving = false) => set("color", likeBright(hex, now()), "color", moving);
    const picker = h("input", { type: "color", class: "vlm-color", oninput: () => put(picker.value, true), onchange: () => put(picker.value) });
    const safe = SAFE.map((hex) => {
      const one = h("button", { type: "button", class: "vlm-chip", title: hex, "aria-label": `colour ${hex}`, onclick: () => put(hex) });
      one.style.background = hex;
      return one;
    });
    const mine = (key: string, label: string, hint: string, empty = "auto") =>
      form.text((m) => by(m) && String(by(m)![key] ?? ""), label, (text) => set(`${name}.${key}`, text && Number.isFinite(Number(text)) ? Number(text) : text || null, label), hint, empty);
    return [
      form.add<any>({
        element: labelled("Colour", picker, h("span", { class: "vlm-chips" }, ...safe)),
        update(value) {
          if (!picker.matches(":focus")) picker.value = vivid(value);
          for (const chip of safe) chip.setAttribute("aria-pressed", String(vivid(value) === chip.title));
        },
      }, (m) => (plain(m) ? m.color ?? [1, 1, 1] : undefined)),
      form.number(
        (m) => (plain(m) ? Number(brightest(m.color ?? 1).toPrecision(4)) : undefined), "Glow", "",
        (value) => set("color", colorOf(now()).map((v) => Number(((v / brightest(now())) * value).toPrecision(4))), "glow"), "Brightness of its brightest channel",
      ),
      form.text(
        (m) => by(m)?.expr ?? "", "Colour by", (expr) => set(name, expr ? { cmap: "inferno", ...by(medium()!), expr } : fallback(name, medium()!), "colour by"),
        "Another expression, whose value at the same place gives the colour", name === "color" ? "one colour" : "its own colours",
      ),
      form.choice((m) => by(m)?.cmap, "Colormap", maps, (map) => set(`${name}.cmap`, map, "colormap")),
      mine("vmin", "From", "Lower end of the colormap"), mine("vmax", "To", "Upper end of the colormap"), mine("brightness", "Glow", "How bright its colours are", "1"),
      form.toggle((m) => by(m) && by(m)!.norm === "log", "logarithm of the values", (on) => set(`${name}.norm`, on ? "log" : null, "scale")),
    ];
  }

  function tableRows(): HTMLElement {
    const body = h("div", { class: "vlm-points" });
    const columns = ["values", "colors", "opacities"] as const;
    /** The same change of all lists; what is one number for all points stays. */
    const change = (how: (list: any[]) => any[], label: string) => {
      const m = medium()!;
      store.set(columns.map((name) => [`medium.${index()}.${name}`, Array.isArray(m[name]) ? how(m[name]) : m[name]]), label);
    };
    const row = (m: Table, k: number) => {
      const cell = (name: string, value: any, type: string, put: (text: string) => void) => {
        const input = h("input", { type, class: type === "text" ? "vlm-number" : "vlm-color", value: String(value), "aria-label": `${name} ${k + 1}`, onchange: () => put(input.value.trim()) });
        return input;
      };
      return h(
        "div", { class: "vlm-point" },
        cell("value", m.values[k], "text", (typed) => typed && set(`values.${k}`, Number.isFinite(Number(typed)) ? likewise(m.values[k], Number(typed)) : typed, "point")),
        cell("optical depth", m.opacities?.[k] ?? m.opacities, "text", (typed) => Number(typed) >= 0 && set(`opacities.${k}`, Number(typed), "point")),
        Array.isArray(m.colors) ? cell("colour", vivid(m.colors[k]), "color", (hex) => set(`colors.${k}`, likeBright(hex, m.colors[k]), "color")) : h("span"),
        button("×", `Remove point ${k + 1}`, () => m.values.length > 2 && change((list) => list.filter((_, i) => i !== k), "remove a point")),
      );
    };
    const add = () => change((list) => [...list.slice(0, -1), middle(...(list.slice(-2) as [any, any])), list[list.length - 1]], "add a point");
    let key = "";
    const update = (m: Table) => {
      const now = JSON.stringify(columns.map((name) => m[name]));
      if (now === key || body.querySelector(":focus")) return;
      key = now;
      refill(body, h("div", { class: "vlm-point vlm-hint" }, ...["value", "τ", "colour"].map((name) => h("span", {}, name))), ...(m.values ?? []).map((_: any, k: number) => row(m, k)));
    };
    return h("div", {}, form.add<Table>({ element: body, update }, (m) => m), button("Add a point", "Add a point between the last two", add, "plus"));
  }

  function make({ type, level }: Table): HTMLElement[] {
    form = new Form<Table>();
    if (type === "coefficients") {
      return [text("Emissivity", "emissivity", "Expression of the fields: intensity per length"), text("Extinction", "extinction", "Expression of the fields: per length")];
    }
    const isMap = type === "colormap";
    return [
      text("Expression", "expr", "Of the fields and coordinates, such as log10(density)"),
      ...(isShell({ type }) ? [quantity("Centre", "center"), quantity("Width", widthName({ type }), type === "gaussian" ? "Standard deviation" : "Half of the width")] : []),
      ...(type === "isosurface" && !Array.isArray(level) ? [quantity("Level", "level")] : []),
      ...(isMap ? [form.choice((m) => m.cmap, "Colormap", maps, (name) => set("cmap", name, "colormap")), quantity("From", "vmin"), quantity("To", "vmax")] : []),
      ...(isMap ? [form.toggle((m) => m.norm === "log", "logarithm of the values", (on) => set("norm", on ? "log" : null, "scale"))] : []),
      ...strength(),
      ...(type === "table" ? [tableRows()] : []),
      ...(isMap ? [] : color(type === "table" ? "colors" : "color")),
      ...(type === "isosurface" ? [] : [text("Path length", "path_length", "What strength and glow refer to; empty: the median thickness of the shell", "auto")]),
      text("Only where", "where", "A condition of the fields, such as temperature > 100", "everywhere"),
      form.slider((m) => numberOf(m.shading) ?? 0, "Shading", [0, 1, 0.05], (v) => pretty(v, 2), (v, moving) => set("shading", v, "shading", moving), "Light from the observer: an illustration, not physics"),
    ];
  }

  return {
    element,
    update() {
      const m = medium();
      const key = m ? `${index()} ${m.type} ${Array.isArray(m.level)}` : "";
      if (key !== shown) refill(element, ...(m ? [h("h2", {}, NAMES[m.type] ?? m.type), ...make(m)] : []));
      shown = key;
      if (m) form.update(m);
    },
  };
}

/** What was typed; of a list its elements. */
function listed(text: string): any {
  try {
    return text.startsWith("[") ? JSON.parse(text) : text;
  } catch {
    return text;
  }
}

/** A colour that was chosen, as bright as an old one. */
function likeBright(hex: string, old: any): number[] {
  const most = Math.max(...colorOf(old ?? 1), 1e-12);
  return colorOf(hex).map((v) => Number((v * most).toPrecision(4)));
}

/** Own colours for a medium that had those of another expression. */
function fallback(name: "color" | "colors", m: Table): any {
  const one = [1, 1, 1].map((v) => v * Math.max(strengthOf(m), 1e-3));
  return name === "color" ? one : m.values.map(() => one);
}

function middle(a: any, b: any): any {
  if (Array.isArray(a) && Array.isArray(b)) return a.map((v, i) => middle(v, b[i]));
  const value = Number((0.5 * (Number.parseFloat(a) + Number.parseFloat(b))).toPrecision(5));
  return likewise(a, value);
}
