// Messages as PROTOCOL.md has them, and how one message with bytes is packed for a websocket.

export type Vec3 = [number, number, number];
export type Table = { [key: string]: any };

export interface Message {
  kind: string;
  [key: string]: any;
}

export interface Field {
  name: string;
  unit: string;
  min: number;
  max: number;
}

export interface VolumeInfo {
  name: string;
  unit: string;
  bounds: [number, number][];
  shape: number[];
  cells: number;
  grid: string;
  fields: Field[];
  coordinates: string[];
  /** Where +x, +y and +z point in a patient, how the cells are turned, and the angles of views by name. */
  orientation?: string;
  direction?: number[][];
  views?: Record<string, { incl: number; phi: number; posang: number }>;
  /** The picture of a stack has y downwards. */
  y_down: boolean;
}

/** The plane on which a frame was drawn, as numbers in the volume's unit (or radians). */
export interface Plane {
  center: Vec3;
  right: Vec3;
  up: Vec3;
  ahead: Vec3;
  width: number;
  height: number;
  shift: [number, number];
  position: Vec3 | null;
}

export interface FrameHead extends Message {
  number: number;
  n: number;
  revision: number;
  camera: Table;
  frame: Plane;
  codec: "log-jpeg" | "linear-jpeg" | "float16";
  /** Of a projection: "max", "min", "mean" …, and in its previews the limits of the values. */
  how?: string;
  limits?: [number, number, number][];
  width: number;
  height: number;
  channels: number;
  scale: number;
  done: number;
  exact: boolean;
  error: number | null;
  level: number;
  every: number;
  ms: number;
  exposure: number;
  low: number;
  high: number;
}

const MAGIC = "VLM1";
const HEAD = 8;

/** Take a packed message apart; the bytes are a view, not a copy. */
export function unpack(data: Uint8Array): { message: Message; bytes: Uint8Array } {
  const text = new TextDecoder();
  if (data.length < HEAD || text.decode(data.subarray(0, 4)) !== MAGIC) {
    throw new Error("this is no message of the explorer");
  }
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const end = HEAD + view.getUint32(4, true);
  if (end > data.length) throw new Error("the message is cut off");
  const message = JSON.parse(text.decode(data.subarray(HEAD, end)));
  return { message, bytes: data.subarray(end) };
}

export function fromBase64(text: string): Uint8Array {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

export function toBase64(bytes: Uint8Array): string {
  return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
}

/** One question at a time: of all that come meanwhile only the newest follows. */
export function newest<T>(ask: (what: T) => Promise<void>): (what: T) => void {
  let next: { what: T } | null = null;
  let busy = false;
  return async (what) => {
    next = { what };
    if (busy) return;
    busy = true;
    while (next) {
      const now = next.what;
      next = null;
      await ask(now);
    }
    busy = false;
  };
}

/** What the explorer needs of anywidget's model; the page makes one over a websocket. */
export interface Model {
  /** Only watches: sends no changes. */
  follows?: boolean;
  /** A link to a scene, with which the page was opened. */
  link?: string;
  on(event: string, callback: (...args: any[]) => void): void;
  off?(event: string, callback?: (...args: any[]) => void): void;
  send(content: any): void;
  /** Go on with an address or a token that was pasted, at another address with this scene; false if it is neither. */
  renew?(given: string, scene: string): boolean;
}
