// A cut through the volume along one of its axes, drawn with a colormap; a click gives the value.

import type { Panel, Parts } from "../parts";
import { ARROWS, h } from "../ui/dom";
import { Form, toggle } from "../ui/fields";
import { pretty, prettyLength, prettyPoint, withUnit } from "../ui/format";
import { fromBase64, type Message, newest, type Vec3 } from "../wire";

const SIZE = 256;
const SIDES = ["x", "y", "z"];

export function slicePanel({ stage, server, notices, overlay, navigation }: Pick<Parts, "stage" | "server" | "notices" | "overlay" | "navigation">): Panel {
  const wish = { expr: "", axis: 2, at: 0.5 };
  const form = new Form<typeof wish>();
  let log: boolean | null = null;
  let reply: Message | null = null;
  let data: Float32Array = new Float32Array();
  const canvas = h("canvas", { class: "vlm-slice", width: SIZE, height: SIZE, tabindex: "0", role: "application", "aria-label": "Slice. Arrow keys read values, Enter rotates about the point." });
  const told = h("p", { class: "vlm-hint vlm-readout" }, "Move over the slice to read values.");
  const fields = () => server.info?.fields.map((f) => f.name) ?? [];
  const change = (what: Partial<typeof wish>) => {
    Object.assign(wish, what);
    form.update(wish);
    load(null);
  };
  const scale = toggle("logarithm", (on) => {
    log = on;
    draw();
  });

  function where(v: number): string {
    const bounds = server.info?.bounds[wish.axis];
    return bounds ? prettyLength(bounds[0] + v * (bounds[1] - bounds[0]), server.info!.unit) : pretty(v);
  }

  const load = newest(async () => {
    if (!wish.expr) return;
    const found = await server.tried("slice", { ...wish, size: SIZE });
    if (!found) return;
    reply = found;
    data = new Float32Array(fromBase64(found.data).buffer, 0, found.width * found.height);
    draw();
  });

  function draw(): void {
    if (!reply) return;
    const { width, height, low, high } = reply;
    const logarithmic = (log ?? (low > 0 && high / low > 100)) && high > 0;
    scale.update(logarithmic);
    const least = logarithmic ? Math.max(low, high * 1e-8) : low;
    const f = logarithmic ? (v: number) => Math.log(Math.max(v, least)) : (v: number) => v;
    const [a, b] = [f(least), f(high)];
    const table = stage.tables.get("inferno")!;
    Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d")!;
    const image = context.createImageData(width, height);
    for (let i = 0; i < width * height; i++) {
      const value = data[(height - 1 - Math.floor(i / width)) * width + (i % width)];
      const entry = 3 * Math.min(255, Math.max(0, Math.floor(((f(value) - a) / (b - a || 1)) * 256)));
      image.data.set([...table.subarray(entry, entry + 3), Number.isFinite(value) ? 255 : 0], 4 * i);
    }
    context.putImageData(image, 0, 0);
  }

  /** Part of the sides at which values are read; moved by the pointer, or by the arrow keys. */
  let spot = [0.5, 0.5];
  function read(): Vec3 | null {
    if (!reply || !server.info) return null;
    const [i, j] = [reply.width, reply.height].map((n, k) => Math.min(n - 1, Math.floor(spot[k] * n)));
    const parts = [...spot];
    const point = server.info.bounds.map(([a, b], k) => a + (k === wish.axis ? wish.at : parts.shift()!) * (b - a)) as Vec3;
    told.textContent = `${wish.expr} = ${withUnit(data[j * reply.width + i], reply.unit)} at ${prettyPoint(point, server.info.unit)}`;
    overlay.probed = point;
    stage.redraw();
    return point;
  }
  const move = (u: number, v: number) => {
    spot = [u, v].map((w) => Math.min(1, Math.max(0, w)));
    return read();
  };
  const take = () => {
    const pivot = read();
    if (!pivot) return;
    navigation.change((view) => ({ ...view, pivot }));
    notices.add("The picture now rotates about that point.", "info");
  };
  canvas.addEventListener("pointermove", (event) => {
    const box = canvas.getBoundingClientRect();
    move((event.clientX - box.left) / box.width, 1 - (event.clientY - box.top) / box.height);
  });
  canvas.addEventListener("click", take);
  canvas.addEventListener("keydown", (event) => {
    const way = ARROWS[event.key];
    if (!way && event.key !== "Enter") return;
    event.preventDefault();
    if (way) move(spot[0] + 0.02 * way[0], spot[1] + 0.02 * way[1]);
    else take();
    notices.announce(told.textContent!);
  });

  return {
    element: h(
      "div", {},
      form.choice((now) => now.expr, "Field", fields, (expr) => change({ expr })),
      form.text(({ expr }) => (fields().includes(expr) ? "" : expr), "Expression", (expr) => change({ expr: expr || fields()[0] }), "Any expression of the fields", "as the field above"),
      form.choice((now) => SIDES[now.axis], "Across", () => SIDES, (name) => change({ axis: SIDES.indexOf(name) })),
      form.slider((now) => now.at, "Place", [0, 1, 0.002], where, (at) => change({ at })),
      canvas, told, scale.element,
      h("p", { class: "vlm-hint" }, "A click (Enter) makes that point the one that rotations turn about."),
    ),
    update() {
      wish.expr ||= fields()[0] ?? "";
      form.update(wish);
    },
    shown: () => load(null),
  };
}
