// What the picture shows, chosen at the picture: the media, or the maximum, mean or minimum of an
// expression along each ray, of the whole volume or of a slab across the view.

import { MODES } from "./legend";
import type { Parts } from "./parts";
import type { Patch } from "./store";
import { button, h } from "./ui/dom";
import { Form } from "./ui/fields";
import { numberOf, prettyLength } from "./ui/format";
import type { Table } from "./wire";

/** The expression that is shown first: of a medium that is no table of labels, else the first field. */
export function mainExpr(media: Table[], fields: { name: string }[]): string {
  return media.find((m) => m.expr && m.type !== "labels")?.expr ?? fields[0]?.name ?? "";
}

export function modes({ store, server, stage }: Pick<Parts, "store" | "server" | "stage">) {
  const now = (): Table => store.document.project ?? {};
  const fields = () => server.info?.fields ?? [];
  const form = new Form<Table>();
  // How each kind of picture was shown: to be shown so again.
  const aside: { volume: Table; projection: Table } = { volume: {}, projection: { colormap: "gray" } };

  function choose(how: string | null): void {
    const image = store.document.image ?? {};
    const { quantity } = now();
    let patch: Patch = [["project.how", how]];
    if (!how) {
      if (quantity) aside.projection = image;
      patch = [["project", {}], ["image", quantity ? aside.volume : image]];
    } else if (!quantity) {
      aside.volume = image;
      patch = [["project", { quantity: mainExpr(store.document.medium ?? [], fields()), how }], ["image", aside.projection]];
    }
    store.set(patch, how ? MODES[how] : "volume");
  }

  /** Another expression has other values: the window is found anew. */
  const show = (quantity: string) => store.set([["project.quantity", quantity || fields()[0]?.name], ["image.vmin", null], ["image.vmax", null]], "what is projected");
  const diagonal = () => Math.hypot(...(server.info?.bounds ?? []).map(([a, b]) => b - a)) || 1;
  /** Where a slab begins: the middle of what is seen. */
  const middle = () => (stage.view?.type === "perspective" ? stage.view.distance : 0);
  const slab = ({ slab }: Table): [number, number] | undefined => slab && [numberOf(slab[0]) ?? 0, numberOf(slab[1]) ?? 1];
  const cut = (depth: number, thickness: number, moving: boolean) => store.set([["project.slab", [depth, thickness].map((v) => Number(v.toPrecision(6)))]], "slab", moving);
  const length = (part: number) => prettyLength(part * diagonal(), server.info?.unit ?? "");
  const part = (v: number) => v * diagonal();

  const buttons = [null, "max", "mean", "min"].map((how) => {
    const label = how ? MODES[how][0].toUpperCase() + MODES[how].slice(1) : "Volume";
    const words = how ? `The ${MODES[how]} along each ray: of cells, at the middle of each pixel` : "The media, as they shine and hide";
    return { how, element: button(label, words, () => choose(how)) };
  });
  const summary = h("summary", { title: "What is projected, and a slab across the view" });
  const more = h("details", { class: "vlm-mode-of", hidden: true }, summary, h(
    "div", {},
    form.choice((p) => String(p.quantity), "Of", () => fields().map((f) => f.name), show),
    form.text((p) => (fields().some((f) => f.name === p.quantity) ? "" : String(p.quantity)), "Expression", show, "Any expression of the fields", "as above"),
    form.toggle((p) => Boolean(p.slab), "slab across the view", (on) => (on ? cut(middle(), 0.1 * diagonal(), false) : store.set([["project.slab", null]], "slab"))),
    form.slider((p) => slab(p) && (slab(p)![0] - middle()) / diagonal(), "Depth", [-0.5, 0.5, 0.002], length, (v, moving) => cut(middle() + part(v), slab(now())![1], moving), "Of the middle of the slab, away from the observer"),
    form.slider((p) => slab(p) && slab(p)![1] / diagonal(), "Thickness", [0.002, 1, 0.002], length, (v, moving) => cut(slab(now())![0], part(v), moving)),
  ));
  return {
    element: h("div", { class: "vlm-modes" }, h("div", { class: "vlm-segments", role: "group", "aria-label": "What the picture shows" }, ...buttons.map((b) => b.element)), more),
    update(): void {
      const { quantity, how = "max" } = now();
      for (const one of buttons) one.element.setAttribute("aria-pressed", String(one.how === (quantity ? how : null)));
      more.hidden = !quantity;
      if (!quantity) return;
      form.update(now());
      const thickness = slab(now())?.[1];
      summary.textContent = `of ${quantity}${thickness ? `, slab of ${length(thickness / diagonal())}` : ""} ▾`;
    },
  };
}
