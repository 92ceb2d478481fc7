// Views that were kept: bookmarks under the keys 1 to 9, in an order that can be a film's keyframes.

import type { App } from "../app";
import { tableOf, type View } from "../camera";
import type { Panel } from "../layout";
import { button, h, refill } from "../ui/dom";
import { numberField } from "../ui/fields";
import { pretty } from "../ui/format";
import { length, sub, times, unit, type Vec3 } from "../vec";

export interface Views extends Panel {
  go(number: number): void;
  keep(number: number): void;
}

const FLIGHT_MS = 450;

export function viewsPanel(app: App): Views {
  let kept: { number: number; view: View; picture: string }[] = [];
  let loaded = "";
  let between = 60;
  const list = h("ol", { class: "vlm-views" });
  const frames = numberField("Frames between", "", (value) => (between = Math.max(1, Math.round(value))));
  frames.update(between);

  const key = () => `voluminous-views ${app.info?.name ?? ""}`;
  const store = () => {
    try {
      localStorage.setItem(key(), JSON.stringify(kept));
    } catch {
      // Without storage they last as long as the page.
    }
  };

  function keep(number: number): void {
    const { view } = app.stage;
    if (!view) return;
    kept = [...kept.filter((k) => k.number !== number), { number, view, picture: thumbnail() }];
    kept.sort((a, b) => a.number - b.number);
    store();
    draw();
    app.notice(`View kept as ${number}: press ${number} to come back`, "info");
  }

  function thumbnail(): string {
    const { canvas } = app.stage;
    const small = h("canvas", { width: 96, height: Math.round(96 / app.stage.aspect) });
    small.getContext("2d")!.drawImage(canvas, 0, 0, small.width, small.height);
    return small.toDataURL("image/jpeg", 0.8);
  }

  function go(number: number): void {
    const found = kept.find((k) => k.number === number);
    if (!found) return app.notice(`No view is kept as ${number}; Shift ${number} keeps one`, "info");
    fly(found.view);
  }

  /** Turn and move there smoothly, so that it is seen where "there" is. */
  function fly(to: View): void {
    const from = app.stage.view;
    if (!from || from.type !== to.type || matchMedia("(prefers-reduced-motion: reduce)").matches) return app.look(to, false);
    const start = performance.now();
    const step = () => {
      const t = Math.min(1, (performance.now() - start) / FLIGHT_MS);
      app.look(t < 1 ? between_(from, to, t * t * (3 - 2 * t)) : to, t < 1);
      if (t < 1) requestAnimationFrame(step);
    };
    step();
  }

  /** What `voluminous.keyframes` takes: (frame, camera) pairs. */
  function python(): string {
    const cameras = kept.map(({ view }, i) => {
      const { type, ...table } = tableOf(view);
      const named = Object.entries(table).map(([name, value]) => `${name}=${JSON.stringify(value)}`);
      return `    (${i * between}, vm.${type === "perspective" ? "Perspective" : "Orthographic"}(${named.join(", ")})),`;
    });
    return `cameras = vm.keyframes([\n${cameras.join("\n")}\n])\n`;
  }

  function draw(): void {
    const rows = kept.map(({ number, view, picture }) =>
      h(
        "li", {},
        h("button", { type: "button", class: "vlm-view", title: `Go there  (${number})`, onclick: () => go(number) },
          h("img", { src: picture, alt: "" }),
          h("kbd", {}, String(number)),
          h("span", {}, `incl ${pretty(view.incl)}°, phi ${pretty(view.phi)}°`)),
        button("×", `Forget view ${number}`, () => {
          kept = kept.filter((k) => k.number !== number);
          store();
          draw();
        }),
      ),
    );
    refill(list, ...(rows.length ? rows : [h("li", { class: "vlm-hint" }, "None yet. Shift and a digit, or the button, keep what is on the screen.")]));
  }

  const next = () => [1, 2, 3, 4, 5, 6, 7, 8, 9].find((n) => !kept.some((k) => k.number === n)) ?? 9;
  return {
    element: h(
      "div", {},
      h("h3", {}, "Kept views"), list,
      h("div", { class: "vlm-actions" }, button("Keep this view", "Under the next free digit", () => keep(next()), "plus")),
      h("h3", {}, "Keyframes of a film"),
      h("p", { class: "vlm-hint" }, "The kept views, in the order of their digits, as Python for voluminous.movie."),
      frames.element,
      h("div", { class: "vlm-actions" }, button("Copy keyframes", "As Python", () => void app.copy(python(), "Keyframes"), "copy")),
    ),
    update() {
      if (loaded === key() || !app.info) return;
      loaded = key();
      try {
        kept = JSON.parse(localStorage.getItem(key()) ?? "[]");
      } catch {
        kept = [];
      }
      draw();
    },
    go,
    keep,
  };
}

/** Between two views of one type: angles the short way, sizes by equal factors. */
function between_(a: View, b: View, t: number): View {
  const mix = (x: number, y: number) => x + t * (y - x);
  const angle = (x: number, y: number) => x + t * (y - x - 360 * Math.round((y - x) / 360));
  const factor = (x: number, y: number) => x * (y / x) ** t;
  const way = sub(b.center, a.center);
  const far = length(way);
  const center = far > 0 ? (a.center.map((v, i) => v + times(unit(way), far * t)[i]) as Vec3) : a.center;
  return {
    ...b, center,
    incl: mix(a.incl, b.incl), phi: angle(a.phi, b.phi), posang: angle(a.posang, b.posang),
    width: factor(a.width, b.width), distance: factor(a.distance, b.distance),
  };
}
