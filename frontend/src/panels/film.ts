// A film of the kept views, around the object, towards it, or through the files of a series: the server
// makes it, and this page gets the file.

import type { App } from "../app";
import { fileMaker } from "../dialogs";
import { button, h } from "../ui/dom";
import { choice, numberField, toggle } from "../ui/fields";
import type { Table } from "../wire";

const KINDS: Record<string, string> = { MP4: "mp4", GIF: "gif", WebP: "webp", "PNG pictures (zip)": "png" };

export interface Film {
  element: HTMLElement;
  frames: number;
  update(): void;
}

export function filmMaker(app: App, cameras: () => Table[]): Film {
  const maker = fileMaker(app);
  const wish = { frames: 120, fps: 24, width: 800, turns: 1, factor: 4, ease: "smooth", what: "mp4", series: false, path: "" };
  const whole = (name: "frames" | "fps" | "width", label: string, unit = "") => {
    const field = numberField(label, unit, (value) => (wish[name] = Math.max(1, Math.round(value))));
    field.update(wish[name]);
    return field.element;
  };
  const number = (name: "turns" | "factor", label: string, hint: string) => {
    const field = numberField(label, "", (value) => (wish[name] = value), hint);
    field.update(wish[name]);
    return field.element;
  };
  const path = choice("Of", [], (name) => {
    wish.path = name;
    update();
  });
  const ease = choice("Ease", ["smooth", "linear", "through"], (name) => (wish.ease = name), "smooth: rests at each view; linear: equal steps; through: does not stop at the views between");
  const turns = number("turns", "Turns", "Once around is 1; the other way is -1");
  const factor = number("factor", "Closer by", "How many times larger things are at the end");
  const series = toggle("time passes", (on) => (wish.series = on), "The files of the series are spread over the film");
  const kind = choice("File", Object.keys(KINDS), (name) => (wish.what = KINDS[name]));
  const options: Record<string, () => Table> = {
    "kept views": () => ({ kind: "keyframes", cameras: cameras(), ease: wish.ease }),
    orbit: () => ({ kind: "orbit", turns: wish.turns }),
    zoom: () => ({ kind: "zoom", factor: wish.factor }),
    "time series": () => ({ kind: "still" }),
  };

  const make = async () => {
    const { frames, fps, width, what } = wish;
    start.disabled = true;
    stop.hidden = false;
    await maker.make("film", { path: options[wish.path](), frames, fps, width, what, series: wish.path === "time series" || (wish.series && !series.element.hidden) });
    stop.hidden = true;
    update();
  };
  const start = button("Make the film", "The server draws it, and this page downloads it", () => void make(), "play");
  const stop = button("Cancel", "Give the film up", maker.cancel);
  stop.hidden = true;

  function update(): void {
    const many = (app.welcome?.series?.count ?? 1) > 1;
    const names = Object.keys(options).filter((name) => name !== "time series" || many);
    path.options(names);
    wish.path ||= "orbit";
    path.update(wish.path);
    ease.element.hidden = wish.path !== "kept views";
    turns.hidden = wish.path !== "orbit";
    factor.hidden = wish.path !== "zoom";
    series.element.hidden = !many || wish.path === "time series";
    start.disabled = !stop.hidden || (wish.path === "kept views" && cameras().length < 2);
    start.title = wish.path === "kept views" && cameras().length < 2 ? "Keep two views first" : "The server draws it, and this page downloads it";
  }

  return {
    element: h(
      "div", { class: "vlm-film" },
      path.element, ease.element, turns, factor, whole("frames", "Frames"), whole("fps", "Speed", "a second"), whole("width", "Width", "pixels"), kind.element, series.element,
      maker.bar, h("div", { class: "vlm-actions" }, start, stop),
    ),
    get frames() {
      return wish.frames;
    },
    update,
  };
}
