// Every key, in one table that the help shows too.

import type { App } from "./app";
import { fromSide, orbit, pan, roll, zoom } from "./camera";

interface Key {
  /** As `KeyboardEvent.key`, or "ctrl+" and that. */
  keys: string[];
  /** As the help shows them. */
  shown: string;
  words: string;
  group: "Camera" | "Picture" | "Document" | "Everything else";
  act(event: KeyboardEvent): void;
}

const STEP = 5;
const FAST = 1.15;

export class Keys {
  readonly table: Key[];
  private hear = (event: KeyboardEvent) => this.pressed(event);
  private target: HTMLElement | Document = document;

  constructor(private app: App) {
    this.table = [...this.camera(), ...this.picture(), ...this.rest()];
  }

  listen(): void {
    const page = this.app.root.closest(".vlm-page") !== null;
    // In a notebook keys belong to the explorer only while it has the focus.
    this.target = page ? document : this.app.root;
    this.target.addEventListener("keydown", this.hear as EventListener);
  }

  close(): void {
    this.target.removeEventListener("keydown", this.hear as EventListener);
  }

  private pressed(event: KeyboardEvent): void {
    const at = event.target as HTMLElement;
    // Digits by their place on the keyboard: with Shift each layout has other signs there.
    const digit = /^Digit([1-9])$/.exec(event.code)?.[1];
    const plain = digit ? (event.shiftKey ? "shift+" : "") + digit : event.key;
    const name = (event.ctrlKey || event.metaKey ? "ctrl+" : "") + plain;
    if (event.altKey || event.defaultPrevented || at.closest?.("dialog[open]")) return;
    const types = /^(INPUT|TEXTAREA|SELECT)$/.test(at.tagName) && (at as HTMLInputElement).type !== "checkbox";
    if (types && !(at as HTMLInputElement).matches("[type=range]")) return;
    // Arrow keys belong to what has the focus; sliders, tabs and handles have their own.
    if (event.key.startsWith("Arrow") && at !== this.app.stage.canvas && at !== document.body) return;
    const found = this.table.find((key) => key.keys.includes(name));
    if (!found) return;
    event.preventDefault();
    event.stopPropagation();
    found.act(event);
  }

  private camera(): Key[] {
    const { app } = this;
    const arrow = (event: KeyboardEvent): [number, number] => [
      event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0,
      event.key === "ArrowUp" ? 1 : event.key === "ArrowDown" ? -1 : 0,
    ];
    const arrows = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"];
    const group = "Camera";
    return [
      {
        keys: arrows, shown: "← → ↑ ↓", words: "rotate by 5°; with Shift move", group,
        act: (event) => {
          const [x, y] = arrow(event);
          app.change((view) => (event.shiftKey ? pan(view, 0.05 * x, 0.05 * y) : orbit(view, STEP * x, STEP * y)));
        },
      },
      {
        keys: arrows.map((a) => "ctrl+" + a), shown: "Ctrl ← →", words: "roll the picture", group,
        act: (event) => app.change((view) => roll(view, -STEP * arrow(event)[0])),
      },
      {
        keys: ["+", "=", "-", "_"], shown: "+ −", words: "zoom", group,
        act: (event) => app.change((view) => zoom(view, "+=".includes(event.key) ? FAST : 1 / FAST, 0, 0)),
      },
      {
        keys: [..."xXyYzZ"], shown: "x X y Y z Z", words: "look from an axis (capitals: its other end)", group,
        act: (event) => app.change((view) => fromSide(view, event.key)),
      },
      { keys: ["f"], shown: "f", words: "fit the whole volume", group, act: () => app.fit() },
      { keys: ["r"], shown: "r", words: "back to the first view", group, act: () => app.reset() },
      { keys: ["o"], shown: "o", words: "parallel rays or perspective", group, act: () => app.switchType() },
      { keys: ["t", "T"], shown: "t", words: "turntable or trackball", group, act: () => app.switchFreely() },
      {
        keys: [..."123456789"], shown: "1 … 9", words: "go to a kept view", group,
        act: (event) => app.layout.views.go(Number(event.code.slice(5))),
      },
      {
        keys: [..."123456789"].map((d) => "shift+" + d), shown: "Shift 1 … 9", words: "keep this view", group,
        act: (event) => app.layout.views.keep(Number(event.code.slice(5))),
      },
    ];
  }

  private picture(): Key[] {
    const { app } = this;
    const group = "Picture";
    return [
      { keys: ["e"], shown: "e E", words: "half a stop brighter, darker", group, act: () => app.expose(0.5) },
      { keys: ["E"], shown: "", words: "", group, act: () => app.expose(-0.5) },
      {
        keys: ["n"], shown: "n", words: "automatic exposure", group,
        act: () => app.store.set([["image.exposure", null]], "automatic exposure"),
      },
      { keys: ["p"], shown: "p", words: "what the middle ray saw", group, act: () => void app.probeAt([0, 0]) },
      { keys: ["a"], shown: "a", words: "rotate about the probed point", group, act: () => app.turnAboutProbe() },
      {
        keys: ["b"], shown: "b", words: "box of the volume on or off", group,
        act: () => {
          app.overlay.shown = !app.overlay.shown;
          app.stage.redraw();
        },
      },
      { keys: ["[", "]"], shown: "[ ]", words: "time step back, forward", group, act: (event) => app.layout.time.step(event.key === "]" ? 1 : -1) },
    ];
  }

  private rest(): Key[] {
    const { app } = this;
    const group = "Document";
    const other = "Everything else";
    return [
      { keys: ["ctrl+z", "u"], shown: "Ctrl Z or u", words: "undo", group, act: () => app.undo() },
      { keys: ["ctrl+Z", "ctrl+y", "U"], shown: "Ctrl Y or U", words: "redo", group, act: () => app.redo() },
      { keys: ["c"], shown: "c", words: "copy as Python", group, act: () => void app.copyScene("python") },
      { keys: ["C"], shown: "C", words: "copy as scene (TOML)", group, act: () => void app.copyScene("toml") },
      { keys: ["l"], shown: "l", words: "copy a link to this scene", group, act: () => void app.copyLink() },
      { keys: ["s"], shown: "s", words: "save a picture or the scene", group, act: () => app.layout.save() },
      { keys: ["m"], shown: "m", words: "show or hide the panels", group: other, act: () => app.layout.togglePanels() },
      { keys: ["?", "h"], shown: "?", words: "this list", group: other, act: () => app.layout.help() },
    ];
  }
}
