// Measures: distances and angles between points where half of the light comes from, and statistics of
// the cells that a medium shows, that fulfil a condition, or that are in a box. They are in the
// document; numbers of cells are the server's, which counts beside everything else.

import { clipOf } from "../clip";
import { angleOf, drawMark, lengthOf, lineOf, type Mark, middleBox } from "../marks";
import { titleOf as mediumTitle } from "../media";
import type { Panel, Parts } from "../parts";
import { button, h, refill } from "../ui/dom";
import { Form } from "../ui/fields";
import { lengthsShownIn, pretty, prettyUnit, suited, withUnit } from "../ui/format";
import { type Message, newest, type Table, type Vec3 } from "../wire";

const DIGITS = 4;
const NEEDED: Record<string, number> = { distance: 2, angle: 3 };
const SAYS = ["Click the first point in the picture (or p: its middle)", "Click the vertex", "Click the last point"];

export interface Measure extends Panel {
  /** Take points for a distance or an angle; null ends it. */
  begin(kind: string | null): void;
  /** Take a place of the picture as the next point; false if none is wanted. */
  takes(place: [number, number]): boolean;
  /** The same for a point of space, from a slice. */
  takesPoint(point: Vec3): boolean;
  addBox(): void;
  addShown(): void;
  /** The picture is at rest: what can be seen of the measures is asked for. */
  rests(): void;
  /** Lines in space and their words, for a saved picture. */
  marks(): Mark[];
}

interface Count {
  reply?: Message;
  error?: string;
  done?: number;
  id?: number;
}

export function measurePanel(
  { stage, store, server, notices, overlay }: Pick<Parts, "stage" | "store" | "server" | "notices" | "overlay">,
  toFront: () => void,
): Measure {
  const wish = { expr: "", medium: 0 };
  const form = new Form<typeof wish>();
  const counts = new Map<string, Count>();
  const says = h("p", { class: "vlm-hint", role: "status" });
  const list = h("ol", { class: "vlm-measures" });
  let kind: string | null = null;
  let points: Vec3[] = [];
  let shown = "";

  const measures = (): Table[] => store.document.measures ?? [];
  const put = (list: Table[], label: string) => store.set([["measures", list]], label);
  const fields = () => server.info?.fields.map((f) => f.name) ?? [];
  const media = (): Table[] => store.document.medium ?? [];
  const nameOf = (medium: Table, i: number) => `${i + 1}  ${mediumTitle(medium)}`;
  const unit = () => server.info?.unit ?? "";

  function begin(next: string | null): void {
    kind = next;
    points = [];
    stage.canvas.classList.toggle("vlm-aiming", kind !== null);
    says.textContent = kind ? `${SAYS[0]}. Esc ends it.` : "";
    if (kind) {
      toFront();
      stage.canvas.focus();
    }
    stage.redraw();
  }

  function takes(place: [number, number]): boolean {
    if (kind) void take(place, kind);
    return kind !== null;
  }

  async function take(place: [number, number], wanted: string): Promise<void> {
    const spot = stage.fromPlace(place);
    const answer = spot && (await server.tried("probe", { x: spot[0], y: spot[1] }));
    if (!answer || kind !== wanted) return;
    if (!answer.point) return notices.add("Nothing shines there, so there is no point to measure from.", "info");
    pointAt(answer.point);
  }

  const takesPoint = (point: Vec3) => kind !== null && (pointAt(point), true);

  /** Take a point, of which a distance needs two and an angle three. */
  function pointAt(point: Vec3): void {
    const wanted = kind!;
    points.push(point.map((v: number) => Number(v.toPrecision(7))) as Vec3);
    const still = NEEDED[wanted] - points.length;
    says.textContent = still ? `${SAYS[still === 1 ? 2 : 1]}. Esc ends it.` : "";
    stage.redraw();
    if (still) return;
    const measure = { kind: wanted, points };
    begin(null);
    add(measure, `measure ${wanted === "angle" ? "an angle" : "a distance"}`);
  }

  function add(measure: Table, label: string): void {
    put([...measures(), measure], label);
    notices.announce(`${titleOf(measure)} ${wordsOf(measure)}`);
  }

  const addBox = () => {
    toFront();
    const { info } = server;
    const box = info && clipOf(store.document.render?.clip ?? "", info.bounds)?.box;
    if (info) add({ kind: "cells", expr: wish.expr, ...(box ? { low: box[0], high: box[1] } : middleBox(info)) }, "measure a box");
  };

  /** The server says where this medium shows: the condition becomes the measure's own. */
  async function addShown(): Promise<void> {
    toFront();
    const clip = store.document.render?.clip;
    const bare = { kind: "cells", expr: wish.expr, ...(clip ? { clip } : {}) };
    const reply = await ask(JSON.stringify([bare, wish.medium]), { measure: bare, medium: wish.medium });
    if (!reply) return;
    const measure = { ...bare, ...(reply.where ? { where: reply.where } : {}) };
    counts.set(keyOf(measure), { reply });
    add(measure, "measure what a medium shows");
  }

  const keyOf = (measure: Table) => JSON.stringify([measure, store.document.volume]);

  /** Count cells in the background; how far that is, and its end, are shown. */
  async function ask(key: string, what: Table): Promise<Message | null> {
    const count: Count = { done: 0 };
    counts.set(key, count);
    const answer = server.ask("measure", what, (part) => {
      count.done = part;
      update();
    });
    count.id = answer.id;
    try {
      count.reply = await answer;
    } catch (error) {
      count.error = (error as Error).message;
    }
    update();
    return count.reply ?? null;
  }

  function titleOf(measure: Table): string {
    if (measure.kind !== "cells") return measure.kind === "angle" ? "Angle" : "Distance";
    return [measure.expr, measure.where ? `where ${measure.where.replace(/<=/g, "≤").replace(/>=/g, "≥")}` : "", measure.low ? "in a box" : measure.clip ? `inside ${measure.clip.replace(/\d+\.\d+/g, (v: string) => Number(Number(v).toPrecision(5)))}` : measure.where ? "" : "of all cells"].filter(Boolean).join(" ");
  }

  function wordsOf(measure: Table): string {
    if (measure.kind === "distance") return withUnit(...suited(lengthOf(measure.points), unit()), DIGITS);
    if (measure.kind === "angle") return `${angleOf(measure.points).toFixed(1)}°`;
    const reply = counts.get(keyOf(measure))?.reply;
    return reply ? `${measure.expr} ${withUnit(reply.mean, reply.mean_unit, DIGITS)}` : measure.expr;
  }

  /** A volume as the cube of a length in the unit that suits it. */
  function volumeOf(reply: Message): string {
    const [side, name] = suited(Math.cbrt(reply.volume), unit());
    // Of a patient: 1 cm³ is 1 ml.
    if (name === "mm" && side >= 10) return `${pretty((side / 10) ** 3, DIGITS)} cm³`;
    return name ? `${pretty(side ** 3, DIGITS)} ${prettyUnit(name)}³` : pretty(reply.volume, DIGITS);
  }

  function numbers(measure: Table): (HTMLElement | null)[] {
    const count = counts.get(keyOf(measure)) ?? {};
    const { reply } = count;
    const again = () => void ask(keyOf(measure), { measure });
    if (count.error) return [h("p", { class: "vlm-wrong", role: "alert" }, count.error === "cancelled" ? "stopped" : count.error), button("Count again", "Count all cells anew", again)];
    if (!reply) {
      const bar = h("progress", { max: 1, value: count.done ?? 0, "aria-label": "cells counted" });
      const stop = button("Stop", "End counting", () => count.id && server.send({ kind: "cancel", of: count.id }));
      return [h("div", { class: "vlm-line" }, h("span", { class: "vlm-hint" }, "counting cells"), bar, stop)];
    }
    const rows: [string, string][] = [
      ["Cells", reply.missing ? `${reply.cells}, ${reply.missing} without a value` : String(reply.cells)],
      ["Volume", volumeOf(reply)],
      ...(["mean", "min", "max"] as const).map((name) => [{ mean: "Mean", min: "Least", max: "Largest" }[name], withUnit(reply[name], reply[`${name}_unit`], DIGITS)] as [string, string]),
      ["Integral", withUnit(reply.total, reply.total_unit, DIGITS)],
    ];
    return [h("dl", { class: "vlm-facts-list" }, ...rows.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]))];
  }

  const change = (i: number, what: Table) => put(measures().map((one, k) => (k === i ? without({ ...one, ...what }) : one)), "change a measure");

  function editor(measure: Table, i: number): HTMLElement {
    const sides = new Form<Table>();
    const corner = (side: "low" | "high", k: number) =>
      sides.number((one) => one[side]?.[k], `${"xyz"[k]} ${side === "low" ? "from" : "to"}`, unit(), (value) => change(i, { [side]: measure[side].map((v: number, j: number) => (j === k ? value : v)) }));
    const box = h(
      "details", { open: open.has(i), ontoggle: () => (box.open ? open.add(i) : open.delete(i)) },
      h("summary", {}, "Change"),
      sides.choice((one) => one.expr, "Field", fields, (expr) => change(i, { expr })),
      sides.text((one) => one.where ?? "", "Where", (where) => change(i, { where }), "A condition that cells must fulfil, such as density > 1", "every cell"),
      ...[0, 1, 2].flatMap((k) => [corner("low", k), corner("high", k)]),
    );
    sides.update(measure);
    return box;
  }
  const open = new Set<number>();

  function row(measure: Table, i: number): HTMLElement {
    const cells = measure.kind === "cells";
    return h(
      "li", {},
      h("div", { class: "vlm-line" }, h("strong", {}, titleOf(measure)), cells ? null : h("span", {}, wordsOf(measure)),
        button("", `Remove: ${titleOf(measure)}`, () => put(measures().filter((_, k) => k !== i), "remove a measure"), "bin")),
      ...(cells ? [...numbers(measure), editor(measure, i)] : []),
    );
  }

  function update(): void {
    if (!fields().includes(wish.expr)) wish.expr = fields()[0] ?? "";
    if (!media()[wish.medium]) wish.medium = 0;
    form.update(wish);
    for (const measure of measures()) if (measure.kind === "cells" && !counts.has(keyOf(measure))) void ask(keyOf(measure), { measure });
    const key = JSON.stringify([measures(), [...counts.values()], lengthsShownIn(unit())]);
    if (key === shown) return;
    shown = key;
    stage.redraw();
    // What is typed in is not taken away.
    if (list.querySelector("input:focus")) return void list.addEventListener("focusout", () => requestAnimationFrame(() => ((shown = ""), update())), { once: true });
    refill(list, ...measures().map(row));
  }

  /** Points of distances and angles as texts, behind what cannot be looked through in the last picture at rest. */
  let behind = new Set<string>();
  const look = newest(async () => {
    const asked = measures().flatMap((one) => (one.points ?? []) as Vec3[]);
    const reply = asked.length && stage.isFlat ? await server.ask("hidden", { points: asked }).catch(() => null) : null;
    behind = new Set(asked.filter((_, i) => reply?.hidden[i]).map(String));
    stage.redraw();
  });

  overlay.layers.push({
    key: () => [measures().map((one) => [one, wordsOf(one)]), points, [...behind]],
    draw: () => [...marks(), ...(points.length ? [{ points, words: "" }] : [])].map((mark) => drawMark(stage, mark, mark.points.some(isHidden))).filter((one) => one !== null),
  });
  const isHidden = (point: Vec3) => behind.has(String(point));

  /** What can be seen of the measures. */
  const marks = (): Mark[] =>
    measures()
      .map((measure) => ({ points: lineOf(measure, counts.get(keyOf(measure))?.reply?.point ?? null), words: wordsOf(measure) }))
      .filter((mark) => !mark.points.every(isHidden));

  return {
    element: h(
      "div", {},
      h("h2", {}, "Distance and angle"),
      h("div", { class: "vlm-actions" }, button("Distance", "Two points  (d)", () => begin("distance")), button("Angle", "Three points, the vertex in the middle  (g)", () => begin("angle"))),
      says,
      h("p", { class: "vlm-hint" }, "Between clicked points: where half of the light of that ray comes from, or the maximum; or in a slice."),
      h("h2", {}, "Statistics of cells"),
      form.choice((now) => now.expr, "Field", fields, (expr) => ((wish.expr = expr), update())),
      form.choice(({ medium }) => (media()[medium] ? nameOf(media()[medium], medium) : undefined), "Medium", () => media().map(nameOf), (name) => ((wish.medium = media().map(nameOf).indexOf(name)), update())),
      h("div", { class: "vlm-actions" },
        button("What it shows", "Statistics of the cells that this medium shows  (V)", () => void addShown()),
        button("A box", "Statistics of a box, whose corners are changed below  (B)", addBox)),
      h("p", { class: "vlm-hint" }, "A medium shows the cells where its extinction (or, if it takes away nothing, its emission) is at least half of its largest; an isosurface those at its level or above. A box counts its part of each cell."),
      list,
    ),
    update,
    begin,
    takes,
    takesPoint,
    addBox,
    addShown: () => void addShown(),
    rests: () => look(null),
    marks,
  };
}

/** Without an empty condition, which stands for all cells. */
function without({ where, ...rest }: Table): Table {
  return where ? { ...rest, where } : rest;
}
