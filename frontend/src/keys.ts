// Every key, in one table that the help shows too.

import type { App } from "./app";
import { fromSide, orbit, otherType, pan, roll, zoom } from "./camera";
import { ARROWS } from "./ui/dom";

/** Keys as `KeyboardEvent.key` (or "ctrl+" and that), as the help shows them (if it does), what they do in words, and that. */
type Row = [keys: string[], shown: string, words: string, act: (event: KeyboardEvent) => void];

const STEP = 5;
const FAST = 1.15;
const DIGITS = [..."123456789"];

export function keyTable(app: App): Record<string, Row[]> {
  const names = Object.keys(ARROWS);
  const go = ({ key, shiftKey }: KeyboardEvent) => {
    const [x, y] = ARROWS[key];
    app.change((view) => (shiftKey ? pan(view, 0.05 * x, 0.05 * y) : orbit(view, STEP * x, STEP * y)));
  };
  const box = () => {
    app.overlay.shown = !app.overlay.shown;
    app.stage.redraw();
  };
  return {
    Camera: [
      [names, "← → ↑ ↓", "rotate by 5°; with Shift move", go],
      [names.map((a) => "ctrl+" + a), "Ctrl ← →", "roll the picture", ({ key }) => app.change((view) => roll(view, -STEP * ARROWS[key][0]))],
      [[..."+=-_"], "+ −", "zoom", ({ key }) => app.change((view) => zoom(view, "+=".includes(key) ? FAST : 1 / FAST, 0, 0))],
      [[..."xXyYzZ"], "x X y Y z Z", "look from an axis (capitals: its other end)", ({ key }) => app.change((view) => fromSide(view, key))],
      [["f"], "f", "fit the whole volume", () => app.fit()],
      [["r"], "r", "back to the first view", () => app.reset()],
      [["o"], "o", "parallel rays or perspective", () => app.change(otherType)],
      [["t", "T"], "t", "turntable or trackball", () => app.switchFreely()],
      [DIGITS, "1 … 9", "go to a kept view", ({ code }) => app.layout.views.go(Number(code.slice(5)))],
      [DIGITS.map((d) => "shift+" + d), "Shift 1 … 9", "keep this view", ({ code }) => app.layout.views.keep(Number(code.slice(5)))],
    ],
    Picture: [
      [["e"], "e E", "half a stop brighter, darker", () => app.expose(0.5)],
      [["E"], "", "", () => app.expose(-0.5)],
      [["n"], "n", "automatic exposure", () => app.store.set([["image.exposure", null]], "automatic exposure")],
      [["p"], "p", "what the middle ray saw", () => void app.probeAt([0, 0])],
      [["a"], "a", "rotate about the probed point", () => app.turnAboutProbe()],
      [["b"], "b", "box of the volume on or off", box],
      [["[", "]"], "[ ]", "time step back, forward", ({ key }) => app.layout.time.step(key === "]" ? 1 : -1)],
    ],
    Document: [
      [["ctrl+z", "u"], "Ctrl Z or u", "undo", () => app.undo()],
      [["ctrl+Z", "ctrl+y", "U"], "Ctrl Y or U", "redo", () => app.redo()],
      [["c"], "c", "copy as Python", () => void app.copyScene("python")],
      [["C"], "C", "copy as scene (TOML)", () => void app.copyScene("toml")],
      [["l"], "l", "copy a link to this scene", () => void app.copyLink()],
      [["s"], "s", "save a picture or the scene", () => app.layout.save()],
    ],
    "Everything else": [
      [["m"], "m", "show or hide the panels", () => app.layout.togglePanels()],
      [["?", "h"], "?", "this list", () => app.layout.help()],
    ],
  };
}

/** Act on keys, until what is returned is called. In a notebook they belong to the explorer only while it has the focus. */
export function listenToKeys(app: App): () => void {
  const rows = Object.values(app.keys).flat();
  const hear = (event: Event) => {
    const { key, code, shiftKey, ctrlKey, metaKey, altKey, defaultPrevented } = event as KeyboardEvent;
    const at = event.target as HTMLInputElement;
    // Digits by their place on the keyboard: with Shift each layout has other signs there.
    const digit = /^Digit([1-9])$/.exec(code)?.[1];
    const name = (ctrlKey || metaKey ? "ctrl+" : "") + (digit ? (shiftKey ? "shift+" : "") + digit : key);
    if (altKey || defaultPrevented || at.closest?.("dialog[open]")) return;
    if (/^(INPUT|TEXTAREA|SELECT)$/.test(at.tagName) && at.type !== "checkbox" && at.type !== "range") return;
    // Arrow keys belong to what has the focus; sliders, tabs and handles have their own.
    if (key in ARROWS && at !== (app.stage.canvas as Element) && at !== document.body) return;
    const found = rows.find(([keys]) => keys.includes(name));
    if (!found) return;
    event.preventDefault();
    event.stopPropagation();
    found[3](event as KeyboardEvent);
  };
  const target = app.root.closest(".vlm-page") ? document : app.root;
  target.addEventListener("keydown", hear);
  return () => target.removeEventListener("keydown", hear);
}
