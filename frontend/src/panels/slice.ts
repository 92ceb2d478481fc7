// A cut through the volume along one of its axes, drawn with a colormap; a click gives the value.

import type { App } from "../app";
import type { Panel } from "../layout";
import { h } from "../ui/dom";
import { choice, slider, textField, toggle } from "../ui/fields";
import { pretty, prettyLength, withUnit } from "../ui/format";
import { fromBase64, type Message, newest, type Vec3 } from "../wire";

const SIZE = 256;
const SIDES = ["x", "y", "z"];

export function slicePanel(app: App): Panel {
  let axis = 2;
  let at = 0.5;
  let expr = "";
  let log: boolean | null = null;
  let reply: Message | null = null;
  let data: Float32Array = new Float32Array();

  const canvas = h("canvas", { class: "vlm-slice", width: SIZE, height: SIZE, role: "img", "aria-label": "slice" });
  const told = h("p", { class: "vlm-hint vlm-readout" }, "Move over the slice to read values.");
  const fields = choice("Field", [], (name) => change(() => (expr = name)));
  const own = textField("Expression", (text) => change(() => (expr = text)), "Any expression of the fields", "as the field above");
  const axes = choice("Across", SIDES, (name) => change(() => (axis = SIDES.indexOf(name))));
  const place = slider("Place", [0, 1, 0.002], (v) => where(v), (v) => change(() => (at = v)));
  const scale = toggle("logarithm", (on) => {
    log = on;
    draw();
  });

  function where(v: number): string {
    const bounds = app.info?.bounds[axis];
    return bounds ? prettyLength(bounds[0] + v * (bounds[1] - bounds[0]), app.info!.unit) : pretty(v);
  }

  function change(how: () => void): void {
    how();
    load(null);
  }

  const load = newest(async () => {
    if (!expr) return;
    try {
      reply = await app.ask("slice", { expr, axis, at, size: SIZE });
      const bytes = fromBase64(reply.data);
      data = new Float32Array(bytes.buffer, 0, reply.width * reply.height);
      draw();
    } catch (error) {
      app.notice((error as Error).message, "warning");
    }
  });

  function draw(): void {
    if (!reply) return;
    const { width, height, low, high } = reply;
    const wide = low > 0 && high / low > 100;
    const logarithmic = (log ?? wide) && high > 0;
    scale.update(logarithmic);
    const least = logarithmic ? Math.max(low, high * 1e-8) : low;
    const f = logarithmic ? (v: number) => Math.log(Math.max(v, least)) : (v: number) => v;
    const [a, b] = [f(least), f(high)];
    const table = app.stage.tables.get("inferno") ?? app.stage.tables.get("viridis");
    canvas.width = width;
    canvas.height = height;
    const context = canvas.getContext("2d")!;
    const image = context.createImageData(width, height);
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        const value = data[(height - 1 - y) * width + x];
        const i = 4 * (y * width + x);
        image.data[i + 3] = Number.isFinite(value) ? 255 : 0;
        const entry = Math.min(255, Math.max(0, Math.floor(((f(value) - a) / (b - a || 1)) * 256)));
        for (let k = 0; k < 3; k++) image.data[i + k] = table ? table[3 * entry + k] : entry;
      }
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
    const point = app.info.bounds.map(([a, b], k) => a + (k === axis ? at : parts.shift()!) * (b - a)) as Vec3;
    return { value: data[j * reply.width + i], point };
  }
  canvas.addEventListener("pointermove", (event) => {
    const found = under(event);
    if (!found) return;
    told.textContent = `${expr} = ${withUnit(found.value, reply!.unit)} at (${found.point.map((v) => prettyLength(v, app.info!.unit)).join(", ")})`;
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
      fields.element, own.element, axes.element, place.element, canvas, told,
      scale.element,
      h("p", { class: "vlm-hint" }, "A click makes that point the one that rotations turn about."),
    ),
    update() {
      const names = app.info?.fields.map((f) => f.name) ?? [];
      fields.options(names);
      if (!expr && names.length) expr = names[0];
      fields.update(expr);
      axes.update(SIDES[axis]);
      place.update(at);
    },
    shown: () => load(null),
  };
}
