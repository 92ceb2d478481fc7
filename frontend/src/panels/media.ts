// The list of media, the histogram above it, and all numbers of the chosen one.

import type { App } from "../app";
import type { Panel } from "../layout";
import { absorbed, canLock, colorFor, fresh, given, isShell, kindOf, NAMES, strengthened, strengthOf, STRONGEST, titleOf, totals, TYPES, WEAKEST, widthName } from "../media";
import { colorOf, SAFE, toHex, vivid } from "../ui/color";
import { button, h, icon, refill } from "../ui/dom";
import { choice, labelled, numberField, slider, textField, toggle } from "../ui/fields";
import { likewise, numberOf, pretty, prettyLength, prettyUnit } from "../ui/format";
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

  let logarithmic: boolean | null = null;
  const axis = toggle("log axis", (on) => {
    logarithmic = on;
    load();
  }, "The axis of values, for expressions without a logarithm of their own");

  /** Whether values are drawn logarithmically: by default those of positive fields over decades. */
  function isLog(expr: string): boolean {
    const field = app.info?.fields.find((f) => f.name === expr);
    return logarithmic ?? Boolean(field && field.min > 0 && field.max / field.min > RATIO_FOR_LOG);
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
    try {
      const reply = { ...(await app.ask("histogram", { expr, bins: BINS, log })), expr };
      known.set(key, reply);
      histogram.show(reply);
    } catch (error) {
      known.delete(key);
      app.notice(`${expr}: ${(error as Error).message}`, "warning");
      histogram.show(null);
    }
  }

  const list = h("ul", { class: "vlm-media", "aria-label": "Media" });
  const editor = mediumEditor(app, () => chosen, histogram, () => histogram.data);

  const add = (medium: Table, label: string) => {
    store.set([["medium", [...media(), medium]]], label);
    select(media().length - 1);
  };
  const kind = h("select", { "aria-label": "Kind of a new medium" }, ...TYPES.map((type) => h("option", { value: type }, NAMES[type])));
  const presets = presetMenu(app, () => select(0));
  const addFresh = () => {
    const expr = exprOf(media()[chosen]);
    const [low, high] = histogram.range;
    add(fresh(kind.value, expr, low, high, null, SAFE[media().length % SAFE.length]), "add a medium");
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
    app.ask("suggest", { name }).then(taken, (error) => app.notice(error.message, "warning"));
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
function mediumEditor(app: App, index: () => number, histogram: Histogram, data: () => Message | null): { element: HTMLElement; update(): void } {
  const element = h("div", { class: "vlm-editor" });
  let shown = "";
  let updates: ((medium: Table) => void)[] = [];
  const { store } = app;
  const medium = (): Table | undefined => store.document.medium?.[index()];
  const path = (name: string) => `medium.${index()}.${name}`;
  const set = (name: string, value: any, label: string, moving = false) => store.set([[path(name), value]], label, moving);

  function quantity(label: string, name: string, unit: () => string, hint?: string): HTMLElement {
    const field = numberField(label, "", (value, moving) => set(name, likewise(medium()?.[name], value), label, moving), hint);
    const after = field.element.querySelector(".vlm-unit")!;
    updates.push((m) => {
      field.update(given(m, name, store.open, index()));
      const own = typeof m[name] === "string" ? m[name].replace(/^\s*[-+0-9.eE]+\s*/, "") : unit();
      after.textContent = m[name] === undefined && field.element.querySelector("input")!.value ? `${prettyUnit(own)} auto` : prettyUnit(own);
    });
    return field.element;
  }

  function text(label: string, name: string, hint?: string, placeholder = ""): HTMLElement {
    const field = textField(label, (value) => set(name, value === "" ? null : value, label), hint, placeholder);
    updates.push((m) => field.update(typeof m[name] === "object" ? JSON.stringify(m[name]) : String(m[name] ?? "")));
    return field.element;
  }

  function strength(): HTMLElement[] {
    const patch = (tau: number, moving: boolean) => store.set(strengthened(medium()!, index(), tau, histogram.locked), "strength", moving);
    const bar = slider("Strength", [WEAKEST, STRONGEST, 0.02], (v) => `τ ${pretty(10 ** v, 2)}`, (v, moving) => patch(10 ** v, moving), "Optical depth of one crossing");
    const exact = numberField("τ per crossing", "", (value) => value >= 0 && patch(value, false));
    const told = h("p", { class: "vlm-hint vlm-readout" });
    const lock = toggle("glow follows strength (S = j/α kept)", (on) => (histogram.locked = on), "Off: emission stays while extinction changes");
    lock.update(histogram.locked);
    updates.push((m) => {
      const tau = strengthOf(m);
      bar.update(Math.log10(Math.max(tau, 10 ** WEAKEST)));
      exact.update(Number(tau.toPrecision(4)));
      const length = m.type === "isosurface" ? null : given(m, "path_length", store.open, index());
      const free = length && tau > 0 ? ` · mean free path ${freePath(m, length / tau)}` : "";
      told.textContent = absorbed(tau) + free;
      lock.element.hidden = !canLock(m);
    });
    const freePath = (m: Table, length: number) => {
      const unit = typeof m.path_length === "string" ? m.path_length.replace(/^\s*[-+0-9.eE]+\s*/, "") : app.info?.unit ?? "";
      return prettyLength(length, unit);
    };
    return [bar.element, exact.element, told, lock.element];
  }

  function color(): HTMLElement[] {
    const picker = h("input", { type: "color", class: "vlm-color" });
    const put = (hex: string, moving: boolean) => {
      const most = Math.max(...colorOf(medium()?.color ?? [1, 1, 1]), 1e-12);
      set("color", colorOf(hex).map((v) => Number((v * most).toPrecision(4))), "color", moving);
    };
    picker.addEventListener("input", () => put(picker.value, true));
    picker.addEventListener("change", () => put(picker.value, false));
    const safe = SAFE.map((hex) => {
      const one = h("button", { type: "button", class: "vlm-chip", title: hex, "aria-label": `color ${hex}`, onclick: () => put(hex, false) });
      one.style.background = hex;
      return one;
    });
    const bright = numberField("Glow", "", (value) => {
      const rgb = colorOf(medium()?.color ?? [1, 1, 1]);
      const most = Math.max(...rgb) || 1;
      set("color", rgb.map((v) => Number(((v / most) * value).toPrecision(4))), "glow");
    }, "Brightness of its brightest channel");
    updates.push((m) => {
      const value = m.color ?? [1, 1, 1];
      const plain = typeof value === "string" || (Array.isArray(value) && value.length === 3 && value.every((v) => typeof v === "number"));
      picker.disabled = !plain;
      if (!picker.matches(":focus")) picker.value = vivid(plain ? value : [1, 1, 1]);
      const rgb = plain ? colorOf(value) : null;
      bright.update(rgb && Number(Math.max(...rgb).toPrecision(4)));
      for (const chip of safe) chip.setAttribute("aria-pressed", String(plain && toHex(colorOf(vivid(value))) === chip.title));
    });
    return [labelled("Color", picker, h("span", { class: "vlm-chips" }, ...safe)), bright.element];
  }

  function tableRows(): HTMLElement {
    const body = h("div", { class: "vlm-points" });
    const change = (m: Table, label: string) => {
      const at = `medium.${index()}.`;
      store.set(["values", "colors", "opacities"].map((name) => [at + name, m[name]]), label);
    };
    const row = (m: Table, k: number) => {
      const value = h("input", { type: "text", class: "vlm-number", value: String(m.values[k]), "aria-label": `value ${k + 1}` });
      const tau = h("input", { type: "text", class: "vlm-number", value: String(m.opacities?.[k] ?? m.opacities), "aria-label": `optical depth ${k + 1}` });
      const tint = h("input", { type: "color", class: "vlm-color", value: vivid(m.colors?.[k] ?? [1, 1, 1]), "aria-label": `color ${k + 1}` });
      value.addEventListener("change", () => {
        const number = Number(value.value);
        if (value.value.trim()) set(`values.${k}`, Number.isFinite(number) ? likewise(m.values[k], number) : value.value.trim(), "point");
      });
      tau.addEventListener("change", () => Number(tau.value) >= 0 && set(`opacities.${k}`, Number(tau.value), "point"));
      tint.addEventListener("change", () => {
        const most = Math.max(...colorOf(m.colors?.[k]), 1e-12);
        set(`colors.${k}`, colorOf(tint.value).map((v) => Number((v * most).toPrecision(4))), "color");
      });
      const without = (list: any) => (Array.isArray(list) ? list.filter((_: any, i: number) => i !== k) : list);
      const drop = () => m.values.length > 2 && change({ values: without(m.values), colors: without(m.colors), opacities: without(m.opacities) }, "remove a point");
      return h("div", { class: "vlm-point" }, value, tau, tint, button("×", `Remove point ${k + 1}`, drop));
    };
    const more = button("Add a point", "Add a point between the last two", () => {
      const m = medium()!;
      const n = m.values.length;
      const between = (list: any) => (Array.isArray(list) ? [...list.slice(0, n - 1), middle(list[n - 2], list[n - 1]), list[n - 1]] : list);
      change({ values: between(m.values), colors: between(m.colors), opacities: between(m.opacities) }, "add a point");
    }, "plus");
    let key = "";
    updates.push((m) => {
      const now = JSON.stringify([m.values, m.colors, m.opacities]);
      if (now === key || body.querySelector(":focus")) return;
      key = now;
      refill(body, h("div", { class: "vlm-point vlm-hint" }, h("span", {}, "value"), h("span", {}, "τ"), h("span", {}, "color")), ...(m.values ?? []).map((_: any, k: number) => row(m, k)));
    });
    return h("div", {}, body, more);
  }

  function make(m: Table): HTMLElement[] {
    updates = [];
    const unit = () => data()?.unit ?? "";
    if (m.type === "coefficients") {
      return [
        text("Emissivity", "emissivity", "Expression of the fields: intensity per length"),
        text("Extinction", "extinction", "Expression of the fields: per length"),
      ];
    }
    const rows = [text("Expression", "expr", "Of the fields and coordinates, such as log10(density)")];
    if (isShell(m)) rows.push(quantity("Centre", "center", unit), quantity("Width", widthName(m), unit, m.type === "gaussian" ? "Standard deviation" : "Half of the width"));
    if (m.type === "isosurface" && !Array.isArray(m.level)) rows.push(quantity("Level", "level", unit));
    if (m.type === "colormap") {
      const maps = [...app.stage.tables.keys()].sort();
      const cmap = choice("Colormap", maps, (name) => set("cmap", name, "colormap"));
      updates.push((now) => cmap.update(now.cmap));
      rows.push(cmap.element, quantity("From", "vmin", unit), quantity("To", "vmax", unit));
    }
    rows.push(...strength());
    if (m.type === "table") rows.push(tableRows());
    else if (m.type !== "colormap") rows.push(...color());
    if (m.type !== "isosurface") rows.push(text("Path length", "path_length", "What strength and glow refer to; empty: the median thickness of the shell", "auto"));
    rows.push(text("Only where", "where", "A condition of the fields, such as temperature > 100", "everywhere"));
    const shade = slider("Shading", [0, 1, 0.05], (v) => pretty(v, 2), (v, moving) => set("shading", v, "shading", moving), "Light from the observer: an illustration, not physics");
    updates.push((now) => shade.update(numberOf(now.shading) ?? 0));
    rows.push(shade.element);
    return rows;
  }

  return {
    element,
    update() {
      const m = medium();
      const key = m ? `${index()} ${m.type} ${Array.isArray(m.level)} ${app.stage.tables.size}` : "";
      if (key !== shown) {
        shown = key;
        refill(element, ...(m ? [h("h3", {}, NAMES[m.type] ?? m.type), ...make(m)] : []));
      }
      if (m) for (const change of updates) change(m);
    },
  };
}

function middle(a: any, b: any): any {
  if (Array.isArray(a) && Array.isArray(b)) return a.map((v, i) => middle(v, b[i]));
  const value = Number((0.5 * (Number.parseFloat(a) + Number.parseFloat(b))).toPrecision(5));
  return likewise(a, value);
}
