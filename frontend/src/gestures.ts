// Mouse, wheel and fingers on the picture, as changes of the view.

import { orbit, pan, roll, sweep, trackball, type View, zoom } from "./camera";
import type { Stage } from "./stage";

export interface Hands {
  view(): View | null;
  /** Another view; `moving` while a gesture lasts. */
  look(view: View, moving: boolean): void;
  click(place: [number, number]): void;
  doubleClick(place: [number, number]): void;
  freely(): boolean;
}

const CLICK_PIXELS = 4;
const DEGREES = 180;
const WHEEL_REST_MS = 200;

export function listen(stage: Stage, hands: Hands): void {
  const { canvas } = stage;
  const down = new Map<number, PointerEvent>();
  let start: { view: View; at: PointerEvent; place: [number, number] } | null = null;
  let dragged = false;

  const begin = (event: PointerEvent) => {
    const view = hands.view();
    start = view && { view, at: event, place: stage.fromMouse(event) };
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, event);
    if (down.size === 1) dragged = false;
    begin(event);
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before || !start) return;
    if (down.size === 2) pinch(before, event);
    else if (down.size === 1) drag(event);
    down.set(event.pointerId, event);
  });

  function drag(event: PointerEvent): void {
    const far = Math.hypot(event.clientX - start!.at.clientX, event.clientY - start!.at.clientY);
    if (!dragged && far < CLICK_PIXELS) return;
    dragged = true;
    const place = stage.fromMouse(event);
    const { view, place: from, at } = start!;
    // Each position is counted from the start: the way between does not matter, but for turntables
    // stopped by the pole.
    const [dx, dy] = [place[0] - from[0], place[1] - from[1]];
    const shorter = Math.min(stage.aspect, 1 / stage.aspect);
    const around = sweep(view);
    let next: View;
    if (event.shiftKey || at.button === 1 || at.button === 2) next = pan(view, dx, dy);
    else if (event.ctrlKey || event.metaKey) next = roll(view, spin(from, place));
    // Inside a panorama the sky follows the hand, so the eye turns the other way.
    else if (around) next = orbit(view, (-dx / stage.across) * around, (-dy / stage.across) * around);
    else if (hands.freely()) next = trackball(view, ball(from, shorter), ball(place, shorter));
    else next = orbit(view, (dx / shorter) * DEGREES, (dy / shorter) * DEGREES);
    hands.look(next, true);
  }

  function pinch(before: PointerEvent, event: PointerEvent): void {
    const view = hands.view();
    const other = [...down.values()].find((p) => p.pointerId !== event.pointerId);
    if (!view || !other) return;
    dragged = true;
    const [a, b, c] = [before, event, other].map((p) => stage.fromMouse(p));
    const grown = Math.hypot(b[0] - c[0], b[1] - c[1]) / Math.max(Math.hypot(a[0] - c[0], a[1] - c[1]), 1e-6);
    const middle = [(b[0] + c[0]) / 2, (b[1] + c[1]) / 2];
    const moved = pan(view, (b[0] - a[0]) / 2, (b[1] - a[1]) / 2);
    hands.look(zoom(moved, grown, middle[0], middle[1]), true);
  }

  const end = (event: PointerEvent) => {
    if (!down.delete(event.pointerId)) return;
    const left = [...down.values()][0];
    if (left) return begin(left);
    const view = hands.view();
    if (dragged && view) hands.look(view, false);
    else if (event.type === "pointerup" && event.button === 0) hands.click(stage.fromMouse(event));
    start = null;
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", (event) => hands.doubleClick(stage.fromMouse(event)));

  let rest = 0;
  canvas.addEventListener(
    "wheel",
    (event) => {
      // In a notebook the wheel scrolls the page until the picture was clicked.
      const ours = canvas.closest(".vlm-page") || canvas.matches(":focus");
      const view = hands.view();
      if (!ours || !view) return;
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : event.deltaMode === 2 ? 300 : 1;
      const amount = Math.max(-1, Math.min(1, (-event.deltaY * lines) / 400));
      const [x, y] = stage.fromMouse(event);
      hands.look(zoom(view, 2 ** amount, x, y), true);
      clearTimeout(rest);
      rest = window.setTimeout(() => {
        const last = hands.view();
        if (last && !down.size) hands.look(last, false);
      }, WHEEL_REST_MS);
    },
    { passive: false },
  );
}

/** The ball of the trackball fills the shorter side. */
function ball([x, y]: [number, number], shorter: number): [number, number] {
  return [(2 * x) / shorter, (2 * y) / shorter];
}

/** Degrees, anticlockwise, between two places as seen from the middle. */
function spin(from: [number, number], to: [number, number]): number {
  return ((Math.atan2(to[1], to[0]) - Math.atan2(from[1], from[0])) * 180) / Math.PI;
}
