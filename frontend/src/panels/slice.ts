// A cut through the volume along one of its axes, drawn with a colormap; a click gives the value.

import type { App } from "../app";
import type { Panel } from "../layout";
import { h } from "../ui/dom";
import { Form, toggle } from "../ui/fields";
import { pretty, prettyLength, prettyPoint, withUnit } from "../ui/format";
import { fromBase64, type Message, newest, type Vec3 } from "../wire";

const SIZE = 256;
const SIDES = ["x", "y", "z"];

export function slicePanel(app: App): Panel {
  const wish = { expr: "", axis: 2, at: 0.5 };
  const form = new Form<typeof wish>();
  let log: boolean | null = null;
  let reply: Message | null = null;
  let data: Float32Array = new Float32Array();
  const canvas = h("canvas", { class: "vlm-slice", width: SIZE, height: SIZE, role: "img", "aria-label": "slice" });
  const told = h("p", { class: "vlm-hint vlm-readout" }, "Move over the slice to read values.");
  const fields = () => app.info?.fields.map((f) => f.name) ?? [];
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
    const bounds = app.info?.bounds[wish.axis];
    return bounds ? prettyLength(bounds[0] + v * (bounds[1] - bounds[0]), app.info!.unit) : pretty(v);
  }

  const load = newest(async () => {
    if (!wish.expr) return;
    const found = await app.tried("slice", { ...wish, size: SIZE });
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
    const table = app.stage.tables.get("inferno")!;
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

  /** Value and point under the pointer. */
  function under(event: MouseEvent): { value: number; point: Vec3 } | null {
    if (!reply || !app.info) return null;
    const box = canvas.getBoundingClientRect();
    const u = (event.clientX - box.left) / box.width;
    const v = 1 - (event.clientY - box.top) / box.height;
    const i = Math.min(reply.width - 1, Math.floor(u * reply.width));
    const j = Math.min(reply.height - 1, Math.max(0, Math.floor(v * reply.height)));
    const parts = [u, v];
    const point = app.info.bounds.map(([a, b], k) => a + (k === wish.axis ? wish.at : parts.shift()!) * (b - a)) as Vec3;
    return { value: data[j * reply.width + i], point };
  }
  canvas.addEventListener("pointermove", (event) => {
    const found = under(event);
    if (!found) return;
    told.textContent = `${wish.expr} = ${withUnit(found.value, reply!.unit)} at ${prettyPoint(found.point, app.info!.unit)}`;
    app.overlay.probed = found.point;
    app.stage.redraw();
  });
  canvas.addEventListener("click", (event) => {
    const pivot = under(event)?.point ?? null;
    if (!pivot) return;
    app.change((view) => ({ ...view, pivot }));
    app.notice("The picture now rotates about that point.", "info");
  });

  return {
    element: h(
      "div", {},
      form.choice((now) => now.expr, "Field", fields, (expr) => change({ expr })),
      form.text(({ expr }) => (fields().includes(expr) ? "" : expr), "Expression", (expr) => change({ expr: expr || fields()[0] }), "Any expression of the fields", "as the field above"),
      form.choice((now) => SIDES[now.axis], "Across", () => SIDES, (name) => change({ axis: SIDES.indexOf(name) })),
      form.slider((now) => now.at, "Place", [0, 1, 0.002], where, (at) => change({ at })),
      canvas, told, scale.element,
      h("p", { class: "vlm-hint" }, "A click makes that point the one that rotations turn about."),
    ),
    update() {
      wish.expr ||= fields()[0] ?? "";
      form.update(wish);
    },
    shown: () => load(null),
  };
}
