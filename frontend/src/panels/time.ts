// A slider through the files of a series, with a button that plays them.

import type { Server } from "../server";
import { button, h, refill, icon } from "../ui/dom";

const PACE_MS = 150;

export function timeBar(server: Server): { element: HTMLElement; update(): void; step(by: number): void } {
  let count = 1;
  let index = 0;
  let timer = 0;
  const input = h("input", { type: "range", min: 0, step: 1, "aria-label": "time step" });
  const told = h("output", {});
  const play = button("", "Play", switchPlay, "play");
  const element = h("div", { class: "vlm-time", hidden: true }, play, input, told);

  function show(): void {
    input.value = String(index);
    told.textContent = `${index + 1} / ${count}`;
    input.setAttribute("aria-valuetext", told.textContent);
  }
  function go(to: number): void {
    const next = ((to % count) + count) % count;
    if (next === index) return;
    index = next;
    show();
    server.input("time", { index });
  }
  function switchPlay(): void {
    clearInterval(timer);
    timer = timer ? 0 : window.setInterval(() => server.isBehind || go(index + 1), PACE_MS);
    refill(play, icon(timer ? "pause" : "play"));
    play.title = timer ? "Stop" : "Play";
    play.setAttribute("aria-label", play.title);
  }
  input.addEventListener("input", () => go(Number(input.value)));

  return {
    element,
    update() {
      const series = server.welcome?.series;
      count = series?.count ?? 1;
      index = series?.index ?? 0;
      input.max = String(count - 1);
      element.hidden = count < 2;
      show();
    },
    step: (by) => void (count > 1 && go(index + by)),
  };
}
