// Fields of all numbers of one medium; made anew when another kind of medium is chosen.

import { absorbed, canLock, given, isShell, NAMES, strengthened, strengthOf, STRONGEST, WEAKEST, widthName } from "../media";
import type { Parts } from "../parts";
import { colorOf, SAFE, vivid } from "../ui/color";
import { button, h, refill } from "../ui/dom";
import { Form, labelled, numberField } from "../ui/fields";
import { likewise, numberOf, pretty, prettyUnit, suited, unitOf } from "../ui/format";
import type { Table } from "../wire";
import type { Histogram } from "./histogram";
import { labelTable } from "./labels";

export function mediumEditor({ stage, store, server }: Pick<Parts, "stage" | "store" | "server">, index: () => number, histogram: Histogram) {
  const element = h("div", { class: "vlm-editor" });
  let shown = "";
  let form = new Form<Table>();
  const medium = (): Table | undefined => store.document.medium?.[index()];
  const set = (name: string, value: any, label: string, moving = false) => store.set([[`medium.${index()}.${name}`, value]], label, moving);
  const maps = () => [...stage.tables.keys()].sort();

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
      return length && strengthOf(m) > 0 ? suited(length / strengthOf(m), unitOf(m.path_length) || server.info?.unit || "") : null;
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
    if (type === "labels") {
      return [form.add(labelTable({ store }, index), (m) => m), text("Path length", "path_length", "What opacities refer to", "auto"), shading()];
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
      shading(),
    ];
  }

  const shading = () =>
    form.slider((m) => numberOf(m.shading) ?? 0, "Shading", [0, 1, 0.05], (v) => pretty(v, 2), (v, moving) => set("shading", v, "shading", moving), "Light from the observer: an illustration, not physics");

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
