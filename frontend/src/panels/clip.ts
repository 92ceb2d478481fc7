// Cuts the volume open: a box with six sliders, whose faces are dragged in the picture, too, and a
// plane across the view.

import { axesOf } from "../camera";
import { type Clip, clipOf, corner, depths, section, textOf, wholeOf } from "../clip";
import type { Panel, Parts } from "../parts";
import { button, h, svg } from "../ui/dom";
import { Form } from "../ui/fields";
import { prettyLength } from "../ui/format";
import { add, dot, times, type Vec3 } from "../vec";

const STEPS: [number, number, number] = [0, 1, 0.002];
const NAMES = ["x", "y", "z"];

export interface ClipPanel extends Panel {
  /** Cut, or show all again. */
  switch(): void;
}

export function clipPanel({ stage, store, server, notices, overlay }: Pick<Parts, "stage" | "store" | "server" | "notices" | "overlay">): ClipPanel {
  const form = new Form<Clip>();
  /** The region that was switched off. */
  let last = "";
  let held: { axis: number; end: number } | null = null;

  const text = (): string => store.document.render?.clip ?? "";
  const bounds = () => server.info!.bounds;
  const now = (): Clip => clipOf(text(), bounds()) ?? wholeOf(bounds());
  const set = (region: string | null, moving = false) => store.set([["render.clip", region]], "clip", moving);
  const put = (clip: Clip, moving = false) => set(textOf(clip, bounds()), moving);
  const part = (axis: number, value: number) => (value - bounds()[axis][0]) / (bounds()[axis][1] - bounds()[axis][0]);

  /** Move a face; the one opposite is not passed. */
  function face(axis: number, end: number, share: number, moving: boolean): void {
    const clip = now();
    const [low, high] = bounds()[axis];
    const other = part(axis, clip.box[1 - end][axis]);
    const free = end ? Math.min(1, Math.max(share, other + STEPS[2])) : Math.max(0, Math.min(share, other - STEPS[2]));
    const box = clip.box.map((v) => [...v]) as [Vec3, Vec3];
    box[end][axis] = free <= 0 ? low : free >= 1 ? high : low + free * (high - low);
    put({ ...clip, box }, moving);
  }

  function across(): void {
    if (!stage.view) return;
    const normal = times(axesOf(stage.view)[2], -1);
    const [low, high] = depths(bounds(), normal);
    put({ ...now(), plane: { normal, depth: (low + high) / 2 } });
  }

  function depth(share: number, moving: boolean): void {
    const clip = now();
    if (!clip.plane) return;
    const [low, high] = depths(bounds(), clip.plane.normal);
    put({ ...clip, plane: { ...clip.plane, depth: low + share * (high - low) } }, moving);
  }

  function toggle(on: boolean): void {
    const was = text();
    if (on && !last) across();
    else set(on ? last : null);
    if (!on) last = was;
    notices.announce(on ? "The volume is cut" : "All of the volume is shown");
  }

  const length = (value: number) => prettyLength(value, server.info!.unit);
  const sliders = NAMES.flatMap((name, axis) =>
    ["from", "to"].map((word, end) =>
      form.slider(
        ({ box }) => part(axis, box[end][axis]), `${name} ${word}`, STEPS,
        (share) => length(bounds()[axis][0] + share * (bounds()[axis][1] - bounds()[axis][0])),
        (share, moving) => face(axis, end, share, moving),
      ),
    ),
  );
  const on = form.toggle(() => text() !== "", "Cut the volume", toggle, "What is outside is not drawn  (k)");
  const deep = form.slider(
    ({ plane }) => {
      if (!plane) return undefined;
      const [low, high] = depths(bounds(), plane.normal);
      return (plane.depth - low) / (high - low);
    },
    "Depth", STEPS, (share) => `${Math.round(100 * share)} %`, depth, "How far behind the nearest corner the plane is",
  );
  const other = h("p", { class: "vlm-hint" });
  const remove = button("Remove", "Remove the plane", () => put({ ...now(), plane: null }));

  // --- in the picture -----------------------------------------------------------------------------

  const faces = NAMES.flatMap((name, axis) => [0, 1].map((end) => handle(name, axis, end)));

  function handle(name: string, axis: number, end: number) {
    const element = svg("circle", { class: `vlm-face vlm-${name}`, r: 7 }, svg("title", {}, `Drag: ${name} ${end ? "to" : "from"}`));
    const center = (): Vec3 => {
      // Beside the middle of the picture, so that close to it faces can be held, too.
      const { box } = now();
      const near = (k: number) => Math.min(box[1][k], Math.max(box[0][k], stage.frameView!.center[k]));
      return [0, 1, 2].map((k) => (k === axis ? box[end][k] : near(k))) as Vec3;
    };
    element.addEventListener("pointerdown", (start) => {
      start.preventDefault();
      const from = center();
      const size = bounds()[axis][1] - bounds()[axis][0];
      const [a, b] = [from, add(from, [0, 1, 2].map((k) => (k === axis ? 1e-3 * size : 0)) as Vec3)].map((p) => stage.toPixels(p));
      const [x, y] = [1e3 * (b.x - a.x), 1e3 * (b.y - a.y)];
      // Seen end on, a face is moved by up and down.
      const [dx, dy] = Math.hypot(x, y) > 12 ? [x, y] : [0, -200];
      const move = (event: PointerEvent, moving: boolean) =>
        face(axis, end, part(axis, from[axis]) + ((event.clientX - start.clientX) * dx + (event.clientY - start.clientY) * dy) / (dx * dx + dy * dy), moving);
      const moved = (event: PointerEvent) => move(event, true);
      const done = (event: PointerEvent) => {
        held = null;
        window.removeEventListener("pointermove", moved);
        move(event, false);
      };
      held = { axis, end };
      window.addEventListener("pointermove", moved);
      window.addEventListener("pointerup", done, { once: true });
    });
    return { element, center };
  }

  const inFront = () => element.offsetParent !== null;
  const shows = () => inFront() || (overlay.shown && text() !== "");

  overlay.layers.push({
    key: () => shows() && [text(), inFront(), held],
    draw() {
      if (!shows() || (text() && !clipOf(text(), bounds()))) return [];
      const clip = now();
      const line = (points: Vec3[]) => points.map((p) => stage.toPixels(p)).map(({ x, y }, i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
      let edges = "";
      for (let i = 0; i < 8; i++) for (const bit of [1, 2, 4]) if (!(i & bit)) edges += line([corner(clip, i), corner(clip, i | bit)]);
      const cut = section(clip);
      const parts: SVGElement[] = [svg("path", { class: "vlm-cut", d: edges })];
      if (cut.length) parts.push(svg("path", { class: "vlm-cut vlm-plane", d: `${line(cut)}Z` }));
      if (!inFront()) return parts;
      const middle = times(add(...clip.box), 0.5);
      const back = axesOf(stage.frameView!)[2];
      for (const { element, center } of faces) {
        const at = center();
        const { x, y } = stage.toPixels(at);
        element.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
        element.classList.toggle("vlm-far", dot(add(at, times(middle, -1)), back) < 0);
        parts.push(element);
      }
      return parts;
    },
  });

  const element = h(
    "div", {},
    on, other,
    h("h2", {}, "Box"), ...sliders,
    h("h2", {}, "Plane across the view"), deep,
    h("div", { class: "vlm-actions" }, button("Across this view", "What is in front of the middle is cut away, as seen from here", across, "cube"), remove),
    h("div", { class: "vlm-actions" }, button("Reset", "Show all of the volume", () => {
      last = "";
      set(null);
    })),
    h("p", { class: "vlm-hint" }, "The faces of the box can be dragged in the picture. Stars, lines and axes are not cut."),
  );
  // Another panel has come in front: handles come and go with this one.
  new ResizeObserver(() => stage.redraw()).observe(element);
  let drawn = "";
  return {
    element,
    update() {
      if (!server.info) return;
      const foreign = text() !== "" && !clipOf(text(), bounds());
      other.hidden = !foreign;
      other.textContent = foreign ? `The scene's own region: ${text()}. Sliders replace it.` : "";
      const clip = now();
      remove.disabled = !clip.plane;
      form.update(clip);
      if (drawn !== text()) stage.redraw();
      drawn = text();
    },
    switch: () => toggle(text() === ""),
  };
}
