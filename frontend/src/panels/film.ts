// A film of the kept views, around the object, towards it, or through the files of a series: the server
// makes it, and this page gets the file.

import { fileMaker } from "../dialogs";
import { dressFields, dressOf, estimator, isOnBlack, PLAIN } from "../dress";
import type { Parts } from "../parts";
import { button, h } from "../ui/dom";
import { Form } from "../ui/fields";
import type { Table } from "../wire";

const KINDS: Record<string, string> = { MP4: "mp4", GIF: "gif", WebP: "webp", "PNG pictures (zip)": "png" };
const DOES = "The server draws it, and this page downloads it";

export function filmMaker(parts: Pick<Parts, "stage" | "store" | "server" | "notices">, cameras: () => Table[]) {
  const maker = fileMaker(parts);
  const wish = { of: "orbit", frames: 120, fps: 24, width: 800, turns: 1, factor: 4, ease: "smooth", file: "MP4", series: false, ...PLAIN };
  type Wish = typeof wish;
  const paths: Record<string, () => Table> = {
    orbit: () => ({ kind: "orbit", turns: wish.turns }),
    zoom: () => ({ kind: "zoom", factor: wish.factor }),
    "kept views": () => ({ kind: "keyframes", cameras: cameras(), ease: wish.ease }),
    "time series": () => ({ kind: "still" }),
  };
  const isSeries = () => (parts.server.welcome?.series?.count ?? 1) > 1;
  const form = new Form<Wish>();
  const put = <K extends keyof Wish>(name: K) => (value: Wish[K]) => {
    wish[name] = value;
    update();
  };
  const whole = (name: "frames" | "fps" | "width") => (value: number) => put(name)(Math.max(1, Math.round(value)));
  const only = (path: string, value: any) => (wish.of === path ? value : undefined);

  // Films have no alpha.
  const may = (name: string) => !isOnBlack(parts.store, name) && (name === "transparent" ? KINDS[wish.file] === "png" : name !== "measures" && (name !== "letters" || Boolean(parts.server.info?.orientation)));
  const ask = () => ({ path: paths[wish.of](), frames: wish.frames, fps: wish.fps, what: KINDS[wish.file], ...dressOf(wish, may) });
  const estimate = estimator(parts.server);
  let touched = false;

  const make = async () => {
    const { of, width, series } = wish;
    stop.hidden = false;
    update();
    await maker.make("film", { ...ask(), width, series: isSeries() && (series || of === "time series") });
    stop.hidden = true;
    update();
  };
  const start = button("Make the film", DOES, () => void make(), "play");
  const stop = button("Cancel", "Give the film up", maker.cancel);
  stop.hidden = true;

  function update(): void {
    form.update(wish);
    const lacks = wish.of === "kept views" && cameras().length < 2;
    start.disabled = lacks || !stop.hidden;
    start.title = lacks ? "Keep two views first" : DOES;
    if (touched && stop.hidden) void estimate.show(lacks ? null : ask(), (wish.width ** 2 / parts.stage.aspect) * wish.frames);
  }

  const element = h(
    "div", { class: "vlm-film", onfocusin: () => touched || ((touched = true), update()) },
    form.choice((now) => now.of, "Of", () => Object.keys(paths).filter((name) => name !== "time series" || isSeries()), put("of")),
    form.choice(() => only("kept views", wish.ease), "Ease", () => ["smooth", "linear", "through"], put("ease"), "smooth: rests at each view; linear: equal steps; through: does not stop between"),
    form.number(() => only("orbit", wish.turns), "Turns", "", put("turns"), "Once around is 1; the other way is -1"),
    form.number(() => only("zoom", wish.factor), "Closer by", "", put("factor"), "How many times larger things are at the end"),
    form.number((now) => now.frames, "Frames", "", whole("frames")),
    form.number((now) => now.fps, "Speed", "a second", whole("fps")),
    form.number((now) => now.width, "Width", "pixels", whole("width")),
    form.choice((now) => now.file, "File", () => Object.keys(KINDS), put("file")),
    form.toggle((now) => (isSeries() && now.of !== "time series" ? now.series : undefined), "time passes", put("series"), "The files of the series are spread over the film"),
    dressFields(form, (what) => (Object.assign(wish, what), update()), may),
    estimate.element, maker.bar, h("div", { class: "vlm-actions" }, start, stop),
  );
  return { element, update, wish };
}
