// The camera of the page: shown at once by moving the last frame, and rightly when the server has
// drawn it.

import { fit, tableOf, type View } from "./camera";
import type { Highlight } from "./highlight";
import type { Notices } from "./notices";
import { fromNamed } from "./orientation";
import type { Overlay } from "./overlay";
import type { Server } from "./server";
import type { Stage } from "./stage";
import type { FrameHead } from "./wire";

export type Navigation = ReturnType<typeof navigate>;

/**
 * @param follows only watches the cameras of others
 * @param changed is called for another view, or another kind of turning
 */
export function navigate(stage: Stage, overlay: Overlay, highlight: Highlight, server: Server, notices: Notices, follows: boolean, changed: (view: View | null) => void) {
  let home: View | null = null;
  let wanted: { view: View; moving: boolean } | null = null;
  let looked = 0;

  function send(): void {
    if (!wanted) return;
    const { view, moving } = wanted;
    wanted = null;
    looked = server.input("look", { camera: tableOf(view), moving });
    changed(view);
  }

  const self = {
    follows,
    /** Send a view that waits for the next frame of the screen. */
    flush: send,
    /** A trackball, or else a turntable. */
    freely: false,
    moving: false,
    look(view: View, moving: boolean): void {
      if (follows) return;
      stage.view = view;
      self.moving = moving;
      highlight.hide();
      overlay.pivot = view.pivot;
      stage.redraw();
      const waiting = wanted !== null;
      wanted = { view, moving };
      // One input for each frame of the screen at most: the newest.
      if (!waiting) requestAnimationFrame(send);
    },
    change(how: (view: View) => View): void {
      if (stage.view) self.look(how(stage.view), false);
    },
    /** Look from a side of the patient, by its letter or name, or from the end of an axis. */
    side(name: string): void {
      const { info } = server;
      if (!info || !stage.view) return;
      const next = fromNamed(info, stage.view, name);
      if (next) self.look(next, false);
      else notices.add("This volume does not say how a patient lies in it: x, y, z and X, Y, Z look along its axes.", "info");
    },
    fit(): void {
      const { info } = server;
      if (info) self.change((view) => fit(view, info.bounds, stage.aspect));
    },
    reset(): void {
      if (home) self.look({ ...home, pivot: null }, false);
    },
    switchFreely(): void {
      self.freely = !self.freely;
      notices.announce(self.freely ? "Trackball" : "Turntable");
      changed(stage.view);
    },
    /** A frame is shown; the first is the view to come back to. */
    shown(head: FrameHead): void {
      const { frameView, view } = stage;
      home ??= frameView;
      // Others may have moved the camera; what was asked for here is not overruled by older frames.
      if (!self.moving && !wanted && head.n >= looked && frameView) stage.view = { ...frameView, pivot: view?.pivot ?? null };
    },
    /** Whether a frame has the newest view that was asked for here. */
    has: (head: FrameHead): boolean => !wanted && head.n >= looked,
    /** The connection is back, and the server shows what another page may have looked at last. */
    resume(): void {
      if (stage.view) self.look(stage.view, false);
    },
  };
  return self;
}
