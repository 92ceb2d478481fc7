// Where there is no WebGL2: the same picture by plain JavaScript, slower.

import { fromCode, fromHalf } from "./half";
import type { Drawn, Picture, Surface } from "./screen";
import { toneOf } from "./tone";

export class Screen2d implements Surface {
  private head: Picture["head"] | null = null;
  private values: Float32Array = new Float32Array();
  private table: Uint8Array | undefined;
  private toned = document.createElement("canvas");
  private key = "";

  constructor(private canvas: HTMLCanvasElement) {}

  take(picture: Picture): void {
    this.head = picture.head;
    this.values = picture.halves ? exact(picture) : preview(picture);
    this.key = "";
  }

  setTable(_name: string, table: Uint8Array): void {
    if (table !== this.table) this.key = "";
    this.table = table;
  }

  draw({ tone, place }: Drawn): void {
    const context = this.canvas.getContext("2d");
    if (!this.head || !context) return;
    const { width, height } = this.head;
    const key = JSON.stringify(tone);
    if (key !== this.key) this.fill(tone);
    this.key = key;
    const { width: w, height: h } = this.canvas;
    context.fillRect(0, 0, w, h);
    const x = (0.5 * (1 + place.shift[0] - place.scale[0])) * w;
    const y = (0.5 * (1 - place.shift[1] - place.scale[1])) * h;
    context.drawImage(this.toned, 0, 0, width, height, x, y, place.scale[0] * w, place.scale[1] * h);
  }

  private fill(tone: Drawn["tone"]): void {
    const { width, height, channels } = this.head!;
    this.toned.width = width;
    this.toned.height = height;
    const context = this.toned.getContext("2d")!;
    const image = context.createImageData(width, height);
    for (let i = 0; i < width * height; i++) {
      const rgb = toneOf(this.values.subarray(i * channels, (i + 1) * channels), tone, this.table);
      for (let k = 0; k < 3; k++) image.data[4 * i + k] = Math.round(255 * rgb[k]);
      image.data[4 * i + 3] = 255;
    }
    context.putImageData(image, 0, 0);
  }
}

function exact({ head, halves }: Picture): Float32Array {
  const count = head.width * head.height;
  const out = new Float32Array(count * head.channels);
  for (let c = 0; c < head.channels; c++) {
    for (let i = 0; i < count; i++) out[i * head.channels + c] = fromHalf(halves![c * count + i]) * 2 ** head.low;
  }
  return out;
}

function preview({ head, bitmap }: Picture): Float32Array {
  const { width, height, channels } = head;
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = channels === 3 ? height : height * channels;
  const context = canvas.getContext("2d")!;
  context.drawImage(bitmap!, 0, 0);
  const codes = context.getImageData(0, 0, canvas.width, canvas.height).data;
  const out = new Float32Array(width * height * channels);
  for (let i = 0; i < width * height; i++) {
    for (let c = 0; c < channels; c++) {
      const code = channels === 3 ? codes[4 * i + c] : codes[4 * (i + c * width * height)];
      out[i * channels + c] = fromCode(code, head);
    }
  }
  return out;
}
