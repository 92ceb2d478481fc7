// What saved pictures and films carry beside their pixels, and what they will take: said before.

import type { Server } from "./server";
import type { Store } from "./store";
import { h } from "./ui/dom";
import type { Form } from "./ui/fields";
import { duration, fileSize } from "./ui/format";
import type { Message, Table } from "./wire";

export const PLAIN = { scale_bar: false, color_bar: false, letters: false, triad: false, measures: false, white: false, transparent: false };
export type Dress = typeof PLAIN;

const MARKS: [keyof Dress, string, string][] = [
  ["scale_bar", "scale bar", "A round length, in the unit that suits it"],
  ["color_bar", "colour bars", "Beside the picture: which value has which colour"],
  ["letters", "letters", "The patient's sides at the borders: R L A P S I"],
  ["measures", "measures", "Distances, angles and boxes, with their numbers"],
  ["triad", "axes", "x, y and z as the camera sees them"],
];

/** Whether a ground cannot be had: a projection is nowhere transparent. */
export const isOnBlack = ({ document }: Store, name: string) => Boolean(document.project?.quantity) && /white|transparent/.test(name);

/** Ticks for them. @param may whether one is offered now */
export function dressFields<S extends Dress>(form: Form<S>, put: (what: Partial<S>) => void, may: (name: keyof Dress) => boolean): HTMLElement {
  const tick = (name: keyof Dress, label: string, hint: string, others: Partial<Dress> = {}) =>
    form.toggle((now) => (may(name) ? now[name] : undefined), label, (on) => put({ ...(on ? others : {}), [name]: on } as Partial<S>), hint);
  return h(
    "div", { class: "vlm-ticks", role: "group", "aria-label": "In the picture" },
    ...MARKS.map(([name, label, hint]) => tick(name, label, hint)),
    tick("white", "white ground", "What shines through is white, for print", { transparent: false }),
    tick("transparent", "transparent ground", "Only what emits or hides is in the file", { white: false }),
  );
}

export const dressOf = (wish: Dress, may: (name: keyof Dress) => boolean): Table => ({
  marks: MARKS.map(([name]) => name).filter((name) => wish[name] && may(name)),
  ground: (["transparent", "white"] as const).find((name) => wish[name] && may(name)) ?? "black",
});

/** Time and size of a file, by small ones that the server makes once for each kind of file. */
export function estimator(server: Server) {
  const element = h("p", { class: "vlm-hint vlm-estimate", role: "status" });
  let key = "";
  let one: Message | null = null;
  let amount = 0;
  const tell = () => {
    if (one?.seconds) element.textContent = `About ${duration(one.start + one.seconds * amount)}, ${fileSize(one.bytes * amount)}`;
    else element.textContent = one ? "Time and size are not known before: the file is larger than memory" : "";
  };
  return {
    element,
    /** @param pixels of all frames; @param what null: nothing to say */
    async show(what: Table | null, pixels: number): Promise<void> {
      amount = pixels;
      const now = what ? JSON.stringify(what) : "";
      if (now === key) return tell();
      key = now;
      one = null;
      element.textContent = what ? "Estimating time and size …" : "";
      const reply = what && (await server.ask("estimate", what).catch(() => null));
      if (now !== key) return;
      one = reply;
      tell();
    },
    forget: () => void (key = ""),
  };
}
