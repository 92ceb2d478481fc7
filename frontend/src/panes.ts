// Three slices beside the picture, through one point: its place is marked in all of them and in the
// picture, and moved from any. Values come as they are in the cells; the window is the page's.

import { mainExpr } from "./modes";
import { letterOf, OPPOSITE } from "./orientation";
import type { Parts } from "./parts";
import { ARROWS, button, h, refill, svg } from "./ui/dom";
import { lengthIn, lengthsShownIn, pretty, suited, ticks, withUnit } from "./ui/format";
import { fromBase64, type Message, newest, type Table, type Vec3 } from "./wire";
import { colorOf } from "./ui/color";
import { inflate } from "./half";

const TYPES: Record<string, any> = { u1: Uint8Array, "<i2": Int16Array, "<u2": Uint16Array, "<f4": Float32Array, "<f8": Float64Array };
/** Pixels of slices through other cells than boxes, and the most. */
const PIXELS = 256;
const MOST_PIXELS = 2048;
const PICTURE = 3;
const CLICK_PIXELS = 4;
/** Pixels of the hand that go through all values. */
const REACH = 400;
const STEP = 0.02;
/** Part of a label's colour over the values. */
const TINT = 0.45;
/** A cell of more pixels is shown as a square. */
const SQUARE = 8;
/** What is to the right and up in slices across left–right, front–back and head–feet, as radiologists have them. */
const RADIOLOGICAL: [name: string, right: string, up: string][] = [["Sagittal", "P", "S"], ["Coronal", "L", "S"], ["Axial", "L", "A"]];

/** How a slice across an axis lies on the screen: an axis, and its sense, to the right and up. */
export interface Lie {
  name: string;
  right: [axis: number, sense: number];
  up: [axis: number, sense: number];
  /** The patient's sides at the right, left, upper and lower border. */
  letters: string[];
}

/** @param code where +x, +y, +z point in a patient, such as "LPS"; of other volumes empty */
export function lieOf(axis: number, code: string, yDown: boolean): Lie {
  const towards = (letter: string): [number, number] => {
    const same = code.indexOf(letter);
    return same >= 0 ? [same, 1] : [code.indexOf(OPPOSITE[letter]), -1];
  };
  const kind = code ? RADIOLOGICAL.find((_, k) => towards("LPS"[k])[0] === axis) : undefined;
  if (kind) {
    const [name, right, up] = kind;
    return { name, right: towards(right), up: towards(up), letters: [right, OPPOSITE[right], up, OPPOSITE[up]] };
  }
  const up = axis === 2 ? 1 : 2;
  return { name: "", right: [axis ? 0 : 1, 1], up: [up, up === 1 && yDown ? -1 : 1], letters: [] };
}

interface Cut {
  reply: Message;
  data: ArrayLike<number>;
  /** What was asked for. */
  key: string;
}

/** Values as the server sent them. */
export async function valuesOf(reply: Message): Promise<ArrayLike<number>> {
  const bytes = await inflate(fromBase64(reply.data));
  return new TYPES[reply.type](bytes.buffer, 0, reply.width * reply.height);
}

/** Number of the value at a cell, counted along x, y, z: rows and columns are the next axes in turn. */
export const placeIn = (axis: number, width: number, cell: number[]): number => cell[(axis + 2) % 3] * width + cell[(axis + 1) % 3];

export type Panes = ReturnType<typeof panesOf>;

/** @param pointed is called when a click has chosen a point */
export function panesOf({ stage, store, server, notices, overlay, navigation }: Pick<Parts, "stage" | "store" | "server" | "notices" | "overlay" | "navigation">, pointed: (point: Vec3) => void) {
  const state = (): Table => store.document.slices ?? {};
  const expr = (): string => state().expr ?? mainExpr(store.document.medium ?? [], server.info?.fields ?? []);
  const bounds = () => server.info?.bounds ?? [[0, 1], [0, 1], [0, 1]];
  /** Where the axes point in a patient; empty if that is unknown. */
  const patient = () => (server.info ? ["x", "y", "z"].map((name) => letterOf(server.info!, name)).join("") : "");
  /** Pixels of slices along an axis: one for each cell, of grids with axes x, y and z. */
  function count(j: number): number {
    const { shape = [], grid, bounds: sides = [] } = server.info ?? {};
    const lengths = sides.map(([a, b]) => b - a);
    const n = grid === "CartesianGrid" ? shape[j] : Math.round((PIXELS * lengths[j]) / Math.max(...lengths));
    return Math.min(Math.max(n, 1), MOST_PIXELS);
  }
  const middle = () => bounds().map(([a, b]) => 0.5 * (a + b)) as Vec3;
  const at = (): Vec3 => (state().at as Vec3 | undefined) ?? middle();
  const labelTable = (): Table | undefined => (store.document.medium ?? []).find((m: Table) => m.type === "labels" && m.expr === state().labels);
  /** Least and greatest value of the field, or of all slices so far, which the window has at first. */
  let limits: [number, number] = [Infinity, -Infinity];
  let of = "";
  let unit = "";
  let whole = -1;
  /** Whether numbers are Hounsfield units, as far as they tell. */
  const isCT = () => {
    const field = server.info?.fields.find((f) => f.name === expr());
    return Boolean(field && field.min < -500 && field.min >= -4096 && field.max > 500);
  };
  /** The pixel of a point, counted along x, y, z. */
  const cellOf = (point: Vec3): number[] => point.map((v, j) => {
    const [low, high] = bounds()[j];
    return Math.min(count(j) - 1, Math.max(0, Math.floor(((v - low) / (high - low)) * count(j))));
  });
  const window_ = (): [number, number] => {
    const [low, high] = state().window ?? (isCT() ? [-160, 240] : limits);
    return low < high ? [low, high] : [low, low + 1];
  };
  const set = (what: Table, label: string, moving = false) => {
    const patch = Object.entries(what).map(([key, value]) => [`slices.${key}`, value] as [string, any]);
    // Who only watches has slices of this page alone.
    if (navigation.follows) store.show(patch);
    else store.set(patch, label, moving);
  };

  /** Go to a point of the volume. */
  function go(point: number[], moving = false): void {
    const inside = point.map((v, k) => Math.min(Math.max(v, bounds()[k][0]), bounds()[k][1])) as Vec3;
    overlay.probed = inside;
    set({ at: inside.map((v) => Number(v.toPrecision(7))) }, "point", moving);
    stage.redraw();
    if (!moving) pointed(inside);
  }

  /** Values so far. */
  function widened(low: number, high: number): void {
    limits = [Math.min(limits[0], low), Math.max(limits[1], high)];
    for (const one of panes) one.draw();
    panel();
  }

  /** Change width and middle of the window. */
  function widen([low, high]: [number, number], factor: number, shift: number, moving: boolean): void {
    const level = 0.5 * (low + high) + shift;
    const half = Math.max(0.5 * (high - low) * factor, 1e-6 * Math.abs(limits[1] - limits[0]) || 1e-30);
    set({ window: [level - half, level + half].map((v) => Number(v.toPrecision(5))) }, "window", moving);
  }

  const larger = (k: number) => {
    const made = button("⤢", "This one alone, or all four", () => alone(k));
    made.className = "vlm-larger";
    return made;
  };

  function pane(axis: number, k: number) {
    const canvas = h("canvas", { class: "vlm-cut" });
    const lines = svg("svg", { class: "vlm-lines", "aria-hidden": "true" });
    const title = h("span", {});
    const told = h("span", { class: "vlm-cut-told" });
    const levels = h("span", { class: "vlm-cut-window" });
    const element = h(
      "div", { class: "vlm-pane", tabindex: "0", role: "application", "aria-roledescription": "slice", "aria-label": "slice" },
      canvas, lines, h("div", { class: "vlm-pane-head" }, title, told), larger(k), levels,
    );
    let shown: Cut | null = null;
    let marked: Cut | null = null;
    let asked = "";
    let drawn = "";
    const lie = () => lieOf(axis, patient(), server.info?.y_down ?? false);

    const load = newest(async (wish: { expr: string; labels: string; at: number; key: string }) => {
      const how = { axis, at: wish.at, size: [count((axis + 1) % 3), count((axis + 2) % 3)] };
      const answer = await server.tried("slice", { expr: wish.expr, ...how });
      if (!answer) return;
      const told = wish.labels && wish.labels !== wish.expr ? await server.tried("slice", { expr: wish.labels, ...how }) : null;
      shown = { reply: answer, data: await valuesOf(answer), key: wish.key };
      marked = told && { reply: told, data: await valuesOf(told), key: "" };
      if (of !== wish.expr) {
        of = wish.expr;
        const field = server.info?.fields.find((f) => f.name === of);
        limits = field && Number.isFinite(field.min) ? [field.min, field.max] : [Infinity, -Infinity];
        // Of an expression one slice may show little: its window is that of all cells.
        if (!field) void server.tried("histogram", { expr: of, bins: 1 }).then((all) => all && of === wish.expr && widened(all.edges[0], all.edges[1]));
      }
      unit = answer.unit;
      widened(answer.low, answer.high);
    });

    /** Where the slice is in the pane: left, top, width and height. */
    function box(): [number, number, number, number] {
      const { right, up } = lie();
      const [w, h_] = [right, up].map(([j]) => bounds()[j][1] - bounds()[j][0]);
      const { clientWidth, clientHeight } = element;
      const scale = Math.min((clientWidth - 44) / w, (clientHeight - 42) / h_);
      return [0.5 * (clientWidth - w * scale) + 12, 0.5 * (clientHeight - h_ * scale) + 2, w * scale, h_ * scale];
    }

    function toScreen(point: Vec3): [number, number] {
      const [x, y, w, h_] = box();
      const [u, v] = [lie().right, lie().up].map(([j, sense]) => {
        const part = (point[j] - bounds()[j][0]) / (bounds()[j][1] - bounds()[j][0]);
        return sense > 0 ? part : 1 - part;
      });
      return [x + u * w, y + (1 - v) * h_];
    }

    function fromScreen(event: MouseEvent): Vec3 {
      const inside = element.getBoundingClientRect();
      const [x, y, w, h_] = box();
      const parts = [(event.clientX - inside.left - x) / w, 1 - (event.clientY - inside.top - y) / h_];
      const point = [...at()] as Vec3;
      [lie().right, lie().up].forEach(([j, sense], i) => {
        const part = sense > 0 ? parts[i] : 1 - parts[i];
        point[j] = bounds()[j][0] + part * (bounds()[j][1] - bounds()[j][0]);
      });
      return point;
    }

    function paint(): void {
      if (!shown) return;
      const { right, up } = lie();
      const { width } = shown.reply;
      const [w, h_] = [right, up].map(([j]) => (j === (axis + 1) % 3 ? width : shown!.reply.height));
      Object.assign(canvas, { width: w, height: h_ });
      const context = canvas.getContext("2d")!;
      const image = context.createImageData(w, h_);
      const pixels = new Uint32Array(image.data.buffer);
      const table = stage.tables.get(state().colormap ?? "gray") ?? new Uint8Array(768).map((_, i) => i / 3);
      const codes = new Uint32Array(256).map((_, i) => 0xff000000 | (table[3 * i + 2] << 16) | (table[3 * i + 1] << 8) | table[3 * i]);
      const [low, high] = window_();
      const f = state().log && high > 0 ? (v: number) => Math.log(Math.max(v, low > 0 ? low : 1e-6 * high)) : (v: number) => v;
      const [a, scale] = [f(low), 256 / (f(high) - f(low) || 1)];
      const tint = tints();
      const [stepX, stepY] = [right, up].map(([j]) => (j === (axis + 1) % 3 ? 1 : width));
      const { data } = shown;
      for (let y = 0, i = 0; y < h_; y++) {
        const row = (up[1] > 0 ? h_ - 1 - y : y) * stepY;
        for (let x = 0; x < w; x++, i++) {
          const n = row + (right[1] > 0 ? x : w - 1 - x) * stepX;
          const value = data[n];
          if (value === value) pixels[i] = codes[Math.min(255, Math.max(0, Math.floor((f(value) - a) * scale)))];
          const color = tint?.get(marked ? marked.data[n] : value);
          if (color) for (let c = 0; c < 3; c++) image.data[4 * i + c] += TINT * (color[c] - image.data[4 * i + c]);
        }
      }
      context.putImageData(image, 0, 0);
    }

    function draw(): void {
      if (!element.clientWidth || !server.info || !state().shown) return;
      const info = server.info;
      const { name, right, up, letters } = lie();
      const [x, y, w, h_] = box();
      const cell = cellOf(at());
      const what = JSON.stringify([shown?.reply.id, marked?.reply.id, window_(), state(), store.document.medium?.filter((m: Table) => m.type === "labels"), w]);
      if (shown && what !== drawn) paint();
      drawn = what;
      canvas.style.cssText = `left:${x}px;top:${y}px;width:${w}px;height:${h_}px`;
      canvas.classList.toggle("vlm-squares", w / (canvas.width || 1) > SQUARE);
      const [cx, cy] = toScreen(at());
      // Numbers of the axes are in the page's unit of lengths.
      const one = lengthIn(`1 ${info.unit}`, lengthsShownIn(info.unit)) || 1;
      const marks = [right, up].flatMap(([j], i) => {
        const [low, high] = bounds()[j];
        return ticks(low * one, high * one, i ? h_ / 60 : w / 90).map((value) => {
          const point = [...at()] as Vec3;
          point[j] = value / one;
          const [px, py] = toScreen(point);
          return i
            ? svg("text", { x: x - 6, y: py + 3.5, "text-anchor": "end" }, pretty(value, 4))
            : svg("text", { x: px, y: y + h_ + 14, "text-anchor": "middle" }, pretty(value, 4));
        });
      });
      const sides: [number, number][] = [[x + w - 12, y + h_ / 2], [x + 12, y + h_ / 2], [x + w / 2, y + 16], [x + w / 2, y + h_ - 8]];
      refill(
        lines,
        svg("rect", { class: "vlm-frame-of", x, y, width: w, height: h_ }),
        svg("path", { class: `vlm-cross vlm-${"xyz"[right[0]]}`, d: `M${cx} ${y}V${cy - 8}M${cx} ${cy + 8}V${y + h_}` }),
        svg("path", { class: `vlm-cross vlm-${"xyz"[up[0]]}`, d: `M${x} ${cy}H${cx - 8}M${cx + 8} ${cy}H${x + w}` }),
        ...marks,
        ...letters.map((letter, i) => svg("text", { class: "vlm-letter", x: sides[i][0], y: sides[i][1], "text-anchor": "middle" }, letter)),
      );
      title.textContent = `${name ? `${name}  ` : ""}${"xyz"[axis]} = ${withUnit(...suited(at()[axis], info.unit), 4)}`;
      levels.style.cssText = `right:${element.clientWidth - x - w + 5}px;bottom:${element.clientHeight - y - h_ + 3}px`;
      levels.textContent = `${expr()}  ${windowWords().replace(/indow|evel/g, "")}`;
      // While another slice is on its way nothing is read from the old one.
      const fresh = shown?.key === asked;
      const value = fresh && shown ? shown.data[placeIn(axis, shown.reply.width, cell)] : NaN;
      const label = fresh && marked ? marked.data[placeIn(axis, marked.reply.width, cell)] : null;
      told.textContent = !fresh ? "…" : `${withUnit(value, unit, 4)}${label ? ` · ${nameOf(label)}` : ""}`;
      element.setAttribute("aria-label", `${title.textContent}: ${expr()} ${told.textContent}`);
      element.dataset.value = String(value);
    }

    let from: { x: number; y: number; window: [number, number] | null; far: boolean } | null = null;
    element.addEventListener("pointerdown", (event) => {
      if ((event.target as Element).closest("button")) return;
      element.setPointerCapture(event.pointerId);
      const windows = event.button === 2 || tool.on;
      from = { x: event.clientX, y: event.clientY, window: windows ? window_() : null, far: false };
      if (!windows) go(fromScreen(event), true);
    });
    element.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
      from.far ||= Math.hypot(dx, dy) > CLICK_PIXELS;
      if (from.window && from.far) widen(from.window, 2 ** ((4 * dx) / REACH), (-dy / REACH) * (from.window[1] - from.window[0]), true);
      else if (!from.window) go(fromScreen(event), true);
    });
    const end = (event: PointerEvent) => {
      if (!from) return;
      if (!from.window) go(fromScreen(event));
      else if (from.far) widen(window_(), 1, 0, false);
      from = null;
    };
    element.addEventListener("pointerup", end);
    element.addEventListener("pointercancel", end);
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("dblclick", () => alone(k));
    element.addEventListener("wheel", (event) => {
      if (!element.closest(".vlm-page") && !element.matches(":focus")) return;
      event.preventDefault();
      leaf(event.deltaY > 0 ? -1 : 1);
    }, { passive: false });

    /** Go on by cells along an axis. */
    function leaf(by: number, j = axis): void {
      const n = count(j);
      const [low, high] = bounds()[j];
      const cell = Math.min(n - 1, Math.max(0, cellOf(at())[j] + by));
      const point = [...at()] as Vec3;
      point[j] = low + ((cell + 0.5) / n) * (high - low);
      go(point);
    }
    element.addEventListener("keydown", (event) => {
      const arrow = ARROWS[event.key];
      const page = { PageUp: 1, PageDown: -1 }[event.key];
      if ((!arrow && !page) || event.target !== element) return;
      event.preventDefault();
      event.stopPropagation();
      if (page) leaf(page);
      else if (event.shiftKey) widen(window_(), 1 + 5 * STEP * arrow[0], STEP * arrow[1] * (limits[1] - limits[0]), false);
      else for (const [i, [j, sense]] of [lie().right, lie().up].entries()) if (arrow[i]) leaf(arrow[i] * sense, j);
      notices.announce(event.shiftKey ? windowWords() : element.getAttribute("aria-label")!);
    });
    return {
      element, draw,
      update(): void {
        if (!state().shown || !server.info || !expr()) return;
        const wish = { expr: expr(), labels: state().labels ?? "", at: (cellOf(at())[axis] + 0.5) / count(axis) };
        const key = JSON.stringify([wish, store.document.volume]);
        const other = key !== asked;
        asked = key;
        if (other) void load({ ...wish, key });
        draw();
      },
    };
  }

  /** Colours of labels that are shown; null without labels. */
  function tints(): Map<number, number[]> | null {
    const { labels } = state();
    if (!labels) return null;
    const table = labelTable();
    if (!table) return new Map([...Array(255).keys()].map((i) => [i + 1, hue(i + 1)]));
    return new Map((table.numbers as number[]).flatMap((n, i) => (table.visible?.[i] ?? table.visible ?? true) === false ? [] : [[n, colorOf(table.colors[i]).map((v) => 255 * v)]]));
  }

  function nameOf(label: number): string {
    const i = labelTable()?.numbers.indexOf(label) ?? -1;
    return i >= 0 ? labelTable()!.labels?.[i] ?? String(label) : String(label);
  }

  const windowWords = () => {
    const [low, high] = window_();
    return `Window ${pretty(high - low, 4)}  Level ${pretty(0.5 * (low + high), 4)}`;
  };

  /** One of the four fills all of the place. */
  function alone(k: number): void {
    whole = whole === k ? -1 : k;
    element.dataset.alone = whole < 0 ? "" : String(whole);
    for (const one of panes) one.draw();
  }

  const tool = { on: false };
  let panel = () => {};
  const panes = [2, 1, 0].map(pane);
  const element = h("div", { class: "vlm-four", "data-alone": "" });
  const observer = new ResizeObserver(() => panes.forEach((one) => one.draw()));
  observer.observe(element);
  return {
    /** Takes the picture's box as the fourth. */
    around(picture: HTMLElement): HTMLElement {
      picture.append(larger(PICTURE));
      refill(element, picture, ...panes.map((one) => one.element));
      return element;
    },
    tool, set, go, state, expr, isCT, patient,
    window: window_,
    get unit() { return unit; },
    get limits() { return limits; },
    onDrawn(callback: () => void): void {
      panel = callback;
    },
    point: at,
    toggle: () => set({ shown: !state().shown, at: state().at ?? overlay.probed ?? middle() }, "slices"),
    update(): void {
      element.classList.toggle("vlm-shown", Boolean(state().shown));
      for (const one of panes) one.update();
    },
  };
}

function hue(n: number): number[] {
  const k = (n * 0.618034) % 1;
  return [0, 1 / 3, 2 / 3].map((shift) => 255 * Math.min(1, Math.max(0, Math.abs((((k + shift) % 1) * 6) - 3) - 0.7)));
}
