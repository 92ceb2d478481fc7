// What the three slices show: a field or an expression, its window, and labels above it.

import type { Panes } from "../panes";
import type { Panel, Parts } from "../parts";
import { h } from "../ui/dom";
import { Form } from "../ui/fields";
import { prettyPoint } from "../ui/format";
import type { Table } from "../wire";

/** Windows of computed tomography: width and level in Hounsfield units. */
const USUAL: Record<string, [number, number]> = { "Soft tissue": [400, 40], Lung: [1500, -600], Bone: [1800, 400], Brain: [80, 40] };

export function slicePanel({ stage, store, server, navigation, notices }: Pick<Parts, "stage" | "store" | "server" | "navigation" | "notices">, panes: Panes): Panel {
  const form = new Form<Table>();
  const fields = () => server.info?.fields.map((f) => f.name) ?? [];
  const { set } = panes;
  const show = (expr: string) => set({ expr: expr || fields()[0], window: null }, "what slices show");
  const spot = h("p", { class: "vlm-hint vlm-readout" });
  const convention = h("p", { class: "vlm-hint" });
  const width = () => panes.window()[1] - panes.window()[0];
  const level = () => 0.5 * (panes.window()[0] + panes.window()[1]);
  const put = (w: number, l: number, moving = false) => w > 0 && set({ window: [l - w / 2, l + w / 2].map((v) => Number(v.toPrecision(5))) }, "window", moving);
  const labels = () => [...new Set([...fields(), ...(store.document.medium ?? []).filter((m: Table) => m.type === "labels").map((m: Table) => m.expr as string)])];
  const turn = () => {
    navigation.change((view) => ({ ...view, pivot: panes.point() }));
    notices.add("The picture now rotates about that point.", "info");
  };
  const update = () => {
    form.update(panes.state());
    ofCT.hidden = !panes.isCT();
    spot.textContent = `Point ${prettyPoint(panes.point(), server.info?.unit ?? "")}`;
    convention.textContent = panes.patient()
      ? "Radiological: the patient's right is at the left, as seen from the feet; coronal from the front, sagittal from the left."
      : panes.isCT() ? "How the patient lies is not known: axes as in the file, across z, y and x." : "";
  };
  panes.onDrawn(update);
  const usual = Object.entries(USUAL).map(([name, [w, l]]) => h("button", { type: "button", title: `Width ${w}, level ${l} HU`, onclick: () => put(w, l) }, name));
  const ofCT = h("div", { class: "vlm-actions" }, ...usual);
  return {
    element: h(
      "div", {},
      form.toggle((now) => Boolean(now.shown), "three slices beside the picture  (q)", panes.toggle),
      form.choice(() => panes.expr(), "Field", fields, show),
      form.text(() => (fields().includes(panes.expr()) ? "" : panes.expr()), "Expression", show, "Any expression of the fields", "as the field above"),
      h("h2", {}, "Window"),
      form.number(() => (Number.isFinite(width()) ? Number(width().toPrecision(5)) : null), "Width", "", (v) => put(v, level()), "From black to white"),
      form.number(() => (Number.isFinite(level()) ? Number(level().toPrecision(5)) : null), "Level", "", (v) => put(width(), v), "The value in the middle, grey"),
      h(
        "div", { class: "vlm-actions" },
        h("button", { type: "button", title: "From the least to the greatest value seen so far", onclick: () => set({ window: panes.isCT() ? [...panes.limits] : null }, "window") }, "All values"),
        h("button", { type: "button", title: "The same window in the picture, of a maximum, mean or minimum", onclick: () => store.set([["image.vmin", panes.window()[0]], ["image.vmax", panes.window()[1]], ["image.exposure", null]], "window") }, "Same in the picture"),
      ),
      ofCT,
      form.toggle(() => panes.tool.on, "a drag changes the window", (on) => (panes.tool.on = on), "As the right button does: to the side the width, up and down the level"),
      form.choice((now) => now.colormap ?? "gray", "Colormap", () => ["gray", ...[...stage.tables.keys()].sort()], (name) => set({ colormap: name }, "colormap of slices")),
      form.toggle((now) => Boolean(now.log), "logarithm of the values", (on) => set({ log: on }, "scale of slices")),
      form.choice((now) => now.labels ?? "none", "Labels", () => ["none", ...labels()], (name) => set({ labels: name === "none" ? null : name }, "labels of slices"), "A field of whole numbers, in the colours of its table"),
      spot,
      h("div", { class: "vlm-actions" }, h("button", { type: "button", onclick: turn }, "Rotate about the point")),
      h("p", { class: "vlm-hint" }, "Click or drag: move the point. Right drag: window and level. Wheel, Page ↑ ↓: next slice. Arrow keys: next cell; with Shift the window. Double click: one alone."),
      convention,
    ),
    update,
  };
}
