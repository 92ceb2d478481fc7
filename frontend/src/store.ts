// The document on the screen. The server's copy is the truth; what the hand does is applied at once
// and kept until the server has confirmed it, so that nothing jumps back and nothing is lost.

import type { Message, Table } from "./wire";

export type Patch = [string, any][];

interface Change {
  n: number;
  patch: Patch;
  label: string;
  moving: boolean;
}

/** The value at a path such as "medium.0.opacity"; undefined if there is none. */
export function valueAt(tree: any, path: string): any {
  let at = tree;
  for (const key of path.split(".")) {
    if (at === null || typeof at !== "object") return undefined;
    at = at[key];
  }
  return at;
}

/** A copy of the tree with another value at a path; null removes it. What is not on the path is shared. */
export function withValue(tree: any, path: string, value: any): any {
  const [key, ...rest] = path.split(".");
  const copy: any = Array.isArray(tree) ? [...tree] : { ...tree };
  if (rest.length) copy[key] = withValue(copy[key] ?? (/^\d+$/.test(rest[0]) ? [] : {}), rest.join("."), value);
  else if (value === null && Array.isArray(copy)) copy.splice(Number(key), 1);
  else if (value === null) delete copy[key];
  else copy[key] = value;
  return copy;
}

export class Store {
  document: Table = {};
  revision = -1;
  /** The newest revision that changed the picture: older frames do not show it. */
  painted = -1;
  undo: string[] = [];
  redo: string[] = [];
  open: Table = {};
  channels = 3;
  /** The file of a series that is shown. */
  time = 0;
  private confirmed: Table = {};
  private pending: Change[] = [];
  private unsent: Change | null = null;
  private held: Patch = [];
  private listeners: (() => void)[] = [];
  private waiting = false;

  /**
   * @param send takes a message to the server
   * @param next the number of a new input
   * @param later calls back when changes may be sent (each frame of the screen)
   */
  constructor(
    private send: (message: Message) => void,
    private next: () => number,
    private later: (callback: () => void) => void,
  ) {}

  listen(callback: () => void): void {
    this.listeners.push(callback);
  }

  /** Apply a change at once, and send it; changes of a moving hand are merged until they are sent. */
  set(patch: Patch, label: string, moving = false): void {
    this.document = applied(this.document, patch);
    this.held = without(this.held, patch);
    const old = this.unsent;
    // What a replaced list holds is not merged into: order matters there.
    const merged = old ? without(old.patch, patch) : [];
    this.unsent = { n: 0, patch: [...merged, ...patch], label, moving };
    if (!moving) this.flush();
    else if (!this.waiting) {
      this.waiting = true;
      this.later(() => {
        this.waiting = false;
        this.flush();
      });
    }
    this.changed();
  }

  /** Show a change without telling the server; `set` follows when the hand lets go. */
  show(patch: Patch): void {
    this.held = [...without(this.held, patch), ...patch];
    this.document = applied(this.document, patch);
    this.changed();
  }

  flush(): void {
    if (!this.unsent) return;
    const change = { ...this.unsent, n: this.next() };
    this.unsent = null;
    this.pending.push(change);
    this.sendChange(change);
  }

  private sendChange({ n, patch, label, moving }: Change): void {
    this.send({ kind: "set", n, patch, label, moving });
  }

  /** Take the server's document; changes that it does not have yet are put on top. */
  receive(message: Message): void {
    this.confirmed = message.document;
    this.revision = message.revision ?? this.revision;
    this.painted = message.painted ?? this.painted;
    this.undo = message.undo ?? this.undo;
    this.redo = message.redo ?? this.redo;
    this.open = message.open ?? this.open;
    this.channels = message.channels ?? this.channels;
    this.time = message.time ?? this.time;
    // A change is also confirmed by a document that has what it wanted.
    const open = (change: Change) => change.n > (message.n ?? -1) && !holds(this.confirmed, change.patch);
    this.pending = this.pending.filter(open);
    this.rebuild();
  }

  /** The server has refused an input: changes up to it are not awaited any more, later ones are. */
  forget(n: number): void {
    this.pending = this.pending.filter((change) => change.n > n);
    this.rebuild();
  }

  private rebuild(): void {
    this.document = this.pending.reduce((tree, change) => applied(tree, change.patch), this.confirmed);
    if (this.unsent) this.document = applied(this.document, this.unsent.patch);
    this.document = applied(this.document, this.held);
    this.changed();
  }

  /** After the connection is back: what was not confirmed goes once more, merged into one change. */
  resend(): void {
    if (!this.pending.length) return;
    const patch = this.pending.flatMap((change) => change.patch);
    const { label } = this.pending[this.pending.length - 1];
    this.pending = [{ n: this.next(), patch, label, moving: false }];
    this.sendChange(this.pending[0]);
  }

  /** Undo changes. */
  goBack(times = 1): void {
    this.flush();
    if (this.undo.length || this.isAhead) this.sendTimes("undo", times);
  }

  goForth(times = 1): void {
    if (this.redo.length) this.sendTimes("redo", times);
  }

  private sendTimes(kind: string, times: number): void {
    for (let i = 0; i < times; i++) this.send({ kind, n: this.next() });
  }

  /** Whether the server has yet to confirm something. */
  get isAhead(): boolean {
    return this.pending.length > 0 || this.unsent !== null;
  }

  /** Whether something is on its way for which the server draws another picture. */
  get awaitsPicture(): boolean {
    const patches = [...this.pending, ...(this.unsent ? [this.unsent] : [])].flatMap((change) => change.patch);
    return patches.some(([path]) => !/^(image\.|bookmarks)/.test(path));
  }

  private changed(): void {
    for (const callback of this.listeners) callback();
  }
}

/** Whether a tree has what a patch asks for. */
function holds(tree: Table, patch: Patch): boolean {
  return patch.every(([path, value]) => {
    const there = valueAt(tree, path);
    return value === null ? there === undefined && !/\.\d+$/.test(path) : JSON.stringify(there) === JSON.stringify(value);
  });
}

/** Changes that others do not replace. */
function without(patch: Patch, others: Patch): Patch {
  return patch.filter(([p]) => !others.some(([q]) => p === q || p.startsWith(q + ".")));
}

export function applied(tree: Table, patch: Patch): Table {
  return patch.reduce((t, [path, value]) => withValue(t, path, value), tree);
}
