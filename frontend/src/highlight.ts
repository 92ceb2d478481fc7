// Where in the picture values are: a tint above it while the pointer is on the histogram. Only at
// rest: what moves has other things to wait for.

import type { Server } from "./server";
import { h } from "./ui/dom";
import { fromBase64, newest } from "./wire";

const TINT = [64, 224, 255];

interface Values {
  expr: string;
  low: number;
  high: number;
}

export class Highlight {
  readonly element = h("canvas", { class: "vlm-highlight", hidden: true, "aria-hidden": "true" });
  private wanted: Values | null = null;

  /**
   * @param rests whether the exact picture of the newest input is there
   * @param marked is called with the values that are shown; null if none are
   */
  constructor(
    private server: Server,
    private rests: () => boolean,
    private marked: (values: string | null) => void,
  ) {}

  /** Show where these values are; nothing if null. */
  readonly ask = (what: Values | null): void => {
    if (JSON.stringify(what) === JSON.stringify(this.wanted)) return;
    this.wanted = what;
    if (what && this.rests()) this.load(what);
    else this.hide();
  };

  hide(): void {
    this.element.hidden = true;
    this.marked(null);
  }

  /** Another picture is there. */
  renew(): void {
    this.hide();
    if (this.wanted && this.rests()) this.load(this.wanted);
  }

  private load = newest(async (what: Values) => {
    if (what !== this.wanted) return;
    try {
      const reply = await this.server.ask("highlight", { ...what });
      if (what === this.wanted && this.rests()) this.draw(reply.width, reply.height, fromBase64(reply.data));
    } catch {
      this.hide();
    }
  });

  private draw(width: number, height: number, strength: Uint8Array): void {
    Object.assign(this.element, { width, height, hidden: false });
    const context = this.element.getContext("2d")!;
    const image = context.createImageData(width, height);
    strength.forEach((alpha, i) => image.data.set([...TINT, alpha], 4 * i));
    context.putImageData(image, 0, 0);
    this.marked(`${this.wanted!.low} ${this.wanted!.high}`);
  }
}
