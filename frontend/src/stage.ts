// The picture: takes frames, shows the newest where the camera of the page has it by now, and says
// where points of space are on the screen.

import { extent, isFlat, project, standIn, type View, viewOf } from "./camera";
import { decode, type Drawn, type Place, Screen, type Surface } from "./screen";
import { Screen2d } from "./screen2d";
import { settle, type Tone } from "./tone";
import { h } from "./ui/dom";
import type { FrameHead, Table, Vec3 } from "./wire";

const FADE_MS = 100;

export class Stage {
  readonly canvas = h("canvas", {
    class: "vlm-canvas",
    tabindex: "0",
    role: "application",
    "aria-roledescription": "3D view",
    "aria-label": "Volume rendering. Arrow keys rotate, plus and minus zoom, question mark lists all keys.",
  });
  /** Head and view of the frame that is shown. */
  head: FrameHead | null = null;
  frameView: View | null = null;
  tone: Tone | null = null;
  /** The camera of the page, which the next frames will show. */
  view: View | null = null;
  image: Table = {};
  tables = new Map<string, Uint8Array>();
  private screen: Surface;
  private before: { head: FrameHead; view: View } | null = null;
  private fadeFrom = -Infinity;
  private newest = -1;
  /** Smallest, smallest positive and largest number of each channel. */
  limits: [number, number, number][] = [];
  private asked = false;
  private unseen: number[] = [];
  private still = matchMedia("(prefers-reduced-motion: reduce)");

  /**
   * @param seen tells the server that a frame was drawn
   * @param drawn is called after each drawing, for what lies above the picture
   */
  constructor(
    private seen: (number: number) => void,
    private drawn: () => void,
  ) {
    this.screen = Screen.on(this.canvas, () => this.redraw()) ?? new Screen2d(this.canvas);
  }

  /** Width over height. */
  get aspect(): number {
    return this.canvas.width / Math.max(this.canvas.height, 1);
  }

  resize(width: number, height: number): void {
    const [w, h] = [Math.max(1, Math.round(width)), Math.max(1, Math.round(height))];
    if (this.canvas.width === w && this.canvas.height === h) return;
    this.canvas.width = w;
    this.canvas.height = h;
    this.draw();
  }

  /** Decode a frame and show it, unless a newer one came first. */
  async take(head: FrameHead, bytes: Uint8Array, moving: boolean): Promise<boolean> {
    const picture = await decode(head, bytes);
    if (head.number <= this.newest) {
      picture.bitmap?.close();
      this.seen(head.number);
      return false;
    }
    this.newest = head.number;
    const view = viewOf(head.camera, head.frame);
    const sharper = !moving && this.frameView !== null && JSON.stringify(view) === JSON.stringify(this.frameView);
    this.before = sharper && this.head ? { head: this.head, view: this.frameView! } : null;
    this.fadeFrom = sharper && !this.still.matches ? performance.now() : -Infinity;
    // A preview does not know its smallest numbers, or not well: those of the last exact frame serve.
    const same = this.head?.how === head.how && this.head?.channels === head.channels && this.limits.length;
    this.limits = (head.exact || !same ? picture.limits : null) ?? (this.limits.length === head.channels ? this.limits : []);
    this.head = head;
    this.frameView = view;
    this.view ??= view;
    this.screen.take(picture);
    this.unseen.push(head.number);
    this.redraw();
    return true;
  }

  /** After the connection was made anew: frames are counted from the start. */
  restart(): void {
    this.newest = -1;
  }

  redraw(): void {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.draw();
      for (const number of this.unseen.splice(0)) this.seen(number);
    });
  }

  private draw(): void {
    if (!this.head || !this.frameView) return;
    const now = this.shown(this.head, this.frameView);
    this.tone = now.tone;
    const table = this.tables.get(now.tone.colormap ?? "");
    if (table) this.screen.setTable(now.tone.colormap!, table);
    const fade = Math.min(1, (performance.now() - this.fadeFrom) / FADE_MS);
    this.screen.draw(now, this.before && this.shown(this.before.head, this.before.view), fade);
    if (fade < 1) this.redraw();
    this.drawn();
  }

  private shown(head: FrameHead, view: View): Drawn {
    return { tone: settle(this.image, { ...head, limits: this.limits.length ? this.limits : undefined }), place: this.place(head, view) };
  }

  /** Width and height of the canvas, in parts of its longer side. */
  private get sides(): [number, number] {
    return [Math.min(1, this.aspect), Math.min(1, 1 / this.aspect)];
  }

  /** Whether the frame is on a plane. Domes and panoramas are shown whole, and have no lines above them. */
  get isFlat(): boolean {
    return isFlat(this.head?.camera ?? {});
  }

  /** Width of the frame, in parts of the canvas' longer side. */
  get across(): number {
    return this.place(this.head!, this.frameView!).scale[0] * this.sides[0];
  }

  private place(head: FrameHead, view: View): Place {
    if (view.base) {
      const shape = head.width / head.height / this.aspect;
      return { scale: [Math.min(1, shape), Math.min(1, 1 / shape)], shift: [0, 0] };
    }
    const { scale, x, y } = standIn(view, this.view ?? view);
    const [cw, ch] = this.sides;
    const { width, height } = head.frame;
    const longer = Math.max(width, height);
    return {
      scale: [(scale * width) / longer / cw, (scale * height) / longer / ch],
      shift: [(2 * x) / cw, (2 * y) / ch],
    };
  }

  /** Where a point of space is in the picture as it is shown: CSS pixels, and distance. */
  toPixels(point: Vec3): { x: number; y: number; depth: number } {
    const at = project(this.frameView!, point);
    const { scale, x, y } = standIn(this.frameView!, this.view ?? this.frameView!);
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const longer = Math.max(w, h);
    return { x: w / 2 + (scale * at.x + x) * longer, y: h / 2 - (scale * at.y + y) * longer, depth: at.depth };
  }

  /** Where a point of space is, in parts of the longer side from the middle: the inverse of a click. */
  toPlace(point: Vec3): [number, number] {
    const { x, y } = this.toPixels(point);
    const { clientWidth: w, clientHeight: h } = this.canvas;
    return [(x - w / 2) / Math.max(w, h), (h / 2 - y) / Math.max(w, h)];
  }

  /** Length in the volume's unit of one CSS pixel, at the distance of the center. */
  get pixel(): number {
    const longer = Math.max(this.canvas.clientWidth, this.canvas.clientHeight);
    return extent(this.view ?? this.frameView!, 1)[0] / longer;
  }

  /** Pixels of a mouse event: parts of the longer side from the middle, right and up. */
  fromMouse(event: { clientX: number; clientY: number }): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    const longer = Math.max(box.width, box.height, 1);
    return [
      (event.clientX - box.left - box.width / 2) / longer,
      (box.top + box.height / 2 - event.clientY) / longer,
    ];
  }

  /** Place in the frame that is shown, 0 to 1 from the left, lower edge; null beside it. */
  fromPlace([x, y]: [number, number]): [number, number] | null {
    if (!this.head || !this.frameView) return null;
    const { scale, shift } = this.place(this.head, this.frameView);
    const [cw, ch] = this.sides;
    const u = 0.5 + ((2 * x) / cw - shift[0]) / scale[0] / 2;
    const v = 0.5 + ((2 * y) / ch - shift[1]) / scale[1] / 2;
    return u >= 0 && u <= 1 && v >= 0 && v <= 1 ? [u, v] : null;
  }
}
