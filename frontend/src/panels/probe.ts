// What one ray saw: fields, coefficients, optical depth and intensity along it, as four plots with one
// cursor, which also moves a mark in the picture.

import { fresh } from "../media";
import type { Panel, Parts } from "../parts";
import { SAFE, vivid } from "../ui/color";
import { button, h, refill } from "../ui/dom";
import { lengthsShownIn, perLength, pretty, prettyLength, prettyPoint, prettyUnit, suited, withUnit } from "../ui/format";
import { channelCurves, coefficientCurves, Plot } from "../ui/lines";
import { add, sub, times, unit } from "../vec";
import { type Message, newest, type Table, type Vec3 } from "../wire";

const FIELDS = ["#e69f00", "#56b4e9", "#cc79a7", "#f0e442", "#009e73", "#b8c4d0"];

export interface Probe extends Panel {
  /** Show what the ray at a place of the picture saw. */
  at(place: [number, number]): Promise<void>;
  /** Show what the ray through a point saw, and leave the mark there. */
  through(point: Vec3): void;
  /** Let rotations turn about the probed point. */
  turnAbout(): void;
}

export function probePanel(
  { stage, store, server, notices, overlay, navigation }: Pick<Parts, "stage" | "store" | "server" | "notices" | "overlay" | "navigation">,
  toFront: () => void,
  pointed: (point: Vec3) => void,
): Probe {
  const facts = h("dl", { class: "vlm-facts-list" });
  const empty = h("p", { class: "vlm-empty" }, "Click in the picture, or press p, to see what that ray saw.");
  const move = (value: number | null) => {
    for (const plot of plots) plot.at(value);
    overlay.probed = value === null ? reply?.point ?? null : along(value) ?? overlay.probed;
    stage.redraw();
  };
  const plots = ["Fields", "j and α", "Optical depth", "Intensity"].map((title) => new Plot(title, move));
  const axis = h("div", { class: "vlm-ray-axis" });
  const expr = h("select", { "aria-label": "Expression of the new medium" });
  const values = h("div", { class: "vlm-row" }, expr);
  let reply: Message | null = null;
  let shown: Message | null = null;
  let shownIn = "";

  /** The point of space at a distance along the probed ray. */
  function along(distance: number): Vec3 | null {
    const plane = stage.head?.frame;
    if (!reply?.point || !plane || reply.depth === null) return null;
    const away = plane.position ? unit(sub(reply.point, plane.position)) : plane.ahead;
    return add(reply.point, times(away, distance - reply.depth));
  }

  const addMedium = () => {
    const media: Table[] = store.document.medium ?? [];
    const name = expr.value;
    const value = valueOf(name);
    if (value === null) return notices.add("Nothing shines there: there is no value to take.", "info");
    const like = media.find((m) => m.expr === name && (m.sigma || m.half_width));
    const field = server.info?.fields.find((f) => f.name === name);
    const made = fresh("gaussian", name, [field?.min ?? value, field?.max ?? value], value, SAFE[media.length % SAFE.length]);
    if (like) made.sigma = like.sigma ?? like.half_width;
    else if (!field) made.sigma = Math.max(Number((Math.abs(value) * 0.03).toPrecision(2)), 1e-6);
    store.set([["medium", [...media, made]]], "add a medium with this value");
    notices.add(`Added a shell at ${name} = ${pretty(value)}`, "info");
  };

  function valueOf(name: string): number | null {
    const told = shown?.values?.[name];
    if (typeof told === "number") return told;
    const line: number[] | undefined = shown?.fields?.[name] ?? shown?.scalars?.[name];
    if (!line || !shown || shown.depth === null) return null;
    const i = nearest(shown.distance, shown.depth);
    return line[i];
  }

  const body = h(
    "div",
    { hidden: true },
    facts,
    h("div", { class: "vlm-figures" }, ...plots.map((plot) => plot.element), axis),
    h("div", { class: "vlm-line" }, h("span", { class: "vlm-label" }, "Value"), values),
    h(
      "div",
      { class: "vlm-actions" },
      button("Add a medium with this value", "A shell where most of the light comes from", addMedium, "plus"),
      button("Rotate about this", "Makes this point the one that stays  (a)", () => turnAbout(), "ball"),
    ),
  );

  async function at(place: [number, number]): Promise<void> {
    if (!(await ask(place))) return;
    overlay.probed = reply!.point ?? null;
    if (overlay.probed) pointed(overlay.probed);
    toFront();
    update();
    stage.redraw();
  }

  async function ask(place: [number, number]): Promise<boolean> {
    const spot = stage.fromPlace(place);
    const answer = spot && (await server.tried("probe", { x: spot[0], y: spot[1] }));
    if (answer) reply = answer;
    return Boolean(answer);
  }

  // Rays take longer than slices: that of a slice's point is asked for when the panel is seen.
  let owed: Vec3 | null = null;
  const follow = newest(async () => {
    const point = owed;
    if (!point || element.closest("[hidden]") || !stage.frameView || !stage.isFlat) return;
    owed = null;
    if (await ask(stage.toPlace(point))) update();
  });
  function through(point: Vec3): void {
    owed = point;
    follow(null);
  }

  function turnAbout(): void {
    const point = reply?.point as Vec3 | null | undefined;
    if (!point) return notices.add("Nothing shines there, so there is no point to rotate about.");
    overlay.pivot = point;
    overlay.probed = null;
    navigation.change((view) => ({ ...view, pivot: point }));
    notices.announce("Rotating about the marked point");
  }

  function update(): void {
    const unit = lengthsShownIn(server.info?.unit ?? "");
    if (!reply || (reply === shown && unit === shownIn)) return;
    [shown, shownIn] = [reply, unit];
    empty.hidden = true;
    body.hidden = false;
    const unitOf = reply.unit ?? server.info?.unit ?? "";
    const light = prettyUnit(reply.units?.intensity);
    const [factor, per] = perLength(unitOf);
    const x: number[] = reply.distance ?? [];
    const fields = Object.entries((reply.fields ?? {}) as Record<string, number[]>);
    plots[0].show(x, fields.map(([name, line], i) => ({ name, values: line, color: FIELDS[i % FIELDS.length] })), fields.length === 1 ? prettyUnit(reply.units?.[fields[0][0]]) : "");
    plots[1].show(x, coefficientCurves(reply.emissivity ?? [], reply.extinction ?? [], factor), light ? `j ${light} ${per}, α ${per}` : per);
    plots[2].show(reply.walls ?? [], channelCurves(reply.optical_depth ?? [], "τ"), "", false);
    plots[3].show(reply.walls ?? [], channelCurves(reply.accumulated ?? [], "I"), light, false);
    const ends = [x[0] ?? 0, x[x.length - 1] ?? 0];
    const most = Math.max(...ends.map(Math.abs));
    const [size, name] = suited(most, unitOf);
    const [from, to] = ends.map((v) => h("span", {}, pretty(most ? (v * size) / most : 0)));
    refill(axis, from, h("span", {}, unitOf ? `distance along the ray in ${prettyUnit(name)}` : "distance along the ray"), to);
    const rows: [string, string][] = [
      ["Intensity", (reply.intensity ?? []).map((v: number) => pretty(v)).join("  ") + ` ${prettyUnit(reply.units?.intensity)}`],
      ["Optical depth", [...new Set((reply.tau ?? []).map((v: number) => pretty(v)))].join("  ")],
      ["Half of the light by", reply.depth === null ? "nowhere: nothing shines" : prettyLength(reply.depth, unitOf)],
    ];
    if (reply.point) rows.push(["Point", prettyPoint(reply.point, unitOf)]);
    for (const [name, value] of Object.entries((reply.values ?? {}) as Record<string, number>)) rows.push([name, withUnit(value, reply.units?.[name])]);
    refill(facts, ...rows.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]));
    const names = [...new Set([...Object.keys(reply.values ?? {}), ...Object.keys(reply.fields ?? {})])];
    const before = expr.value;
    refill(expr, ...names.map((name) => h("option", { value: name }, name)));
    if (names.includes(before)) expr.value = before;
    const color = vivid(reply.intensity ?? [1, 1, 1]);
    facts.style.setProperty("--seen", color);
    notices.announce(rows.map((row) => row.join(" ")).join("; "));
  }

  const element = h("div", {}, empty, body);
  return { element, update, at, through, turnAbout, shown: () => follow(null) };
}

function nearest(list: number[], value: number): number {
  return list.reduce((best, v, i) => (Math.abs(v - value) < Math.abs(list[best] - value) ? i : best), 0);
}
