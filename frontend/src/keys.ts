// Every key, in one table that the help shows too.

import { orbit, otherType, pan, roll, zoom } from "./camera";
import type { Parts } from "./parts";
import { ARROWS } from "./ui/dom";
import { pretty } from "./ui/format";

/** What keys do beside the parts. */
interface Actions {
  views: { go(key: number): void; keep(key: number): void };
  time: { step(by: number): void };
  measure: { begin(kind: string | null): void; addBox(): void; addShown(): void };
  probe: { at(place: [number, number]): Promise<void>; turnAbout(): void };
  panes: { toggle(): void };
  clip: { switch(): void };
  save(): void;
  help(): void;
  togglePanels(): void;
}

/** Keys as `KeyboardEvent.key` (or "ctrl+" and that), as the help shows them (if it does), what they do in words, and that. */
export type Row = [keys: string[], shown: string, words: string, act: (event: KeyboardEvent) => void];

const STEP = 5;
const FAST = 1.15;
const DIGITS = [..."123456789"];

export function keyTable({ stage, store, notices, overlay, navigation, scenes }: Parts, { views, time, probe, measure, panes, clip, ...actions }: Actions): Record<string, Row[]> {
  const names = Object.keys(ARROWS);
  const go = ({ key, shiftKey }: KeyboardEvent) => {
    const [x, y] = ARROWS[key];
    navigation.change((view) => (shiftKey ? pan(view, 0.05 * x, 0.05 * y) : orbit(view, STEP * x, STEP * y)));
  };
  const box = () => {
    overlay.shown = !overlay.shown;
    stage.redraw();
  };
  /** Change the exposure by stops, from what is shown now. */
  const expose = (stops: number) => {
    const now = Number(store.document.image?.exposure ?? stage.head?.exposure ?? 1);
    store.set([["image.exposure", now * 2 ** stops]], "exposure");
    notices.announce(`Exposure ${pretty(now * 2 ** stops)}`);
  };
  return {
    Camera: [
      [names, "← → ↑ ↓", "rotate by 5°; with Shift move", go],
      [names.map((a) => "ctrl+" + a), "Ctrl ← →", "roll the picture", ({ key }) => navigation.change((view) => roll(view, -STEP * ARROWS[key][0]))],
      [[..."+=-_"], "+ −", "zoom", ({ key }) => navigation.change((view) => zoom(view, "+=".includes(key) ? FAST : 1 / FAST, 0, 0))],
      [[..."xXyYzZ"], "x X y Y z Z", "look from an axis (capitals: its other end)", ({ key }) => navigation.side(key)],
      [[..."APLRSI"], "A P L R S I", "look from anterior, posterior, left, right, superior, inferior", ({ key }) => navigation.side(key)],
      [["f"], "f", "fit the whole volume", () => navigation.fit()],
      [["r"], "r", "back to the first view", () => navigation.reset()],
      [["o"], "o", "parallel rays or perspective", () => navigation.change(otherType)],
      [["t", "T"], "t", "turntable or trackball", () => navigation.switchFreely()],
      [DIGITS, "1 … 9", "go to a kept view", ({ code }) => views.go(Number(code.slice(5)))],
      [DIGITS.map((d) => "shift+" + d), "Shift 1 … 9", "keep this view", ({ code }) => views.keep(Number(code.slice(5)))],
    ],
    Picture: [
      [["e"], "e E", "half a stop brighter, darker", () => expose(0.5)],
      [["E"], "", "", () => expose(-0.5)],
      [["n"], "n", "automatic exposure", () => store.set([["image.exposure", null]], "automatic exposure")],
      [["p"], "p", "what the middle ray saw", () => void probe.at([0, 0])],
      [["a"], "a", "rotate about the probed point", () => probe.turnAbout()],
      [["b"], "b", "box of the volume on or off", box],
      [["q"], "q", "three slices beside the picture", () => panes.toggle()],
      [["k"], "k", "cut the volume, or show all", () => clip.switch()],
      [["[", "]"], "[ ]", "time step back, forward", ({ key }) => time.step(key === "]" ? 1 : -1)],
    ],
    Measure: [
      [["d"], "d", "distance between two points", () => measure.begin("distance")],
      [["g"], "g", "angle at the second of three points", () => measure.begin("angle")],
      [["Escape"], "Esc", "no more points", () => measure.begin(null)],
      [["V"], "V", "statistics of what a medium shows", () => measure.addShown()],
      [["B"], "B", "statistics of a box", () => measure.addBox()],
    ],
    Document: [
      [["ctrl+z", "u"], "Ctrl Z or u", "undo", () => store.goBack()],
      [["ctrl+Z", "ctrl+y", "U"], "Ctrl Y or U", "redo", () => store.goForth()],
      [["c"], "c", "copy as Python", () => void scenes.copy("python")],
      [["C"], "C", "copy as scene (TOML)", () => void scenes.copy("toml")],
      [["l"], "l", "copy a link to this scene", () => void scenes.copyLink()],
      [["s"], "s", "save a picture or the scene", () => actions.save()],
    ],
    "Everything else": [
      [["m"], "m", "show or hide the panels", () => actions.togglePanels()],
      [["?", "h"], "?", "this list", () => actions.help()],
    ],
  };
}

/** Act on keys, until what is returned is called. In a notebook they belong to the explorer only while it has the focus. */
export function listenToKeys(table: Record<string, Row[]>, root: HTMLElement, canvas: Element): () => void {
  const rows = Object.values(table).flat();
  const hear = (event: Event) => {
    const { key, code, shiftKey, ctrlKey, metaKey, altKey, defaultPrevented } = event as KeyboardEvent;
    const at = event.target as HTMLInputElement;
    // Digits by their place on the keyboard: with Shift each layout has other signs there.
    const digit = /^Digit([1-9])$/.exec(code)?.[1];
    const name = (ctrlKey || metaKey ? "ctrl+" : "") + (digit ? (shiftKey ? "shift+" : "") + digit : key);
    if (altKey || defaultPrevented || at.closest?.("dialog[open]")) return;
    if (/^(INPUT|TEXTAREA|SELECT)$/.test(at.tagName) && at.type !== "checkbox" && at.type !== "range") return;
    // Arrow keys belong to what has the focus; sliders, tabs and handles have their own.
    if (key in ARROWS && (at as Element) !== canvas && at !== document.body) return;
    const found = rows.find(([keys]) => keys.includes(name));
    if (!found) return;
    event.preventDefault();
    event.stopPropagation();
    found[3](event as KeyboardEvent);
  };
  const target = root.closest(".vlm-page") ? document : root;
  target.addEventListener("keydown", hear);
  return () => target.removeEventListener("keydown", hear);
}
