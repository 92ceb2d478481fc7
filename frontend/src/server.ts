// The other end: questions with answers, numbered inputs and which of them it has not shown yet.

import type { Notices } from "./notices";
import type { Message, Model, Table, VolumeInfo } from "./wire";

const BUSY_MS = 500;

export class Server {
  /** The greeting: the volume, presets, the series. */
  welcome: Message | null = null;
  /** Sends what waits: answers are on what the page shows. */
  beforeAsking = (): void => {};
  private inputs = 0;
  private unanswered: { n: number; at: number }[] = [];
  private asked = 0;
  private waiting = new Map<number, { done(m: Message): void; failed(e: Error): void; progress?(part: number): void }>();

  constructor(
    private model: Model,
    private notices: Notices,
  ) {}

  get info(): VolumeInfo | null {
    return this.welcome?.volume ?? null;
  }

  send(message: Message): void {
    this.model.send(message);
  }

  /** The number of a new input. */
  number(): number {
    const n = ++this.inputs;
    this.unanswered.push({ n, at: performance.now() });
    return n;
  }

  /** Send an input; its number is returned. */
  input(kind: string, what: Table = {}): number {
    const n = this.number();
    this.send({ kind, n, ...what });
    return n;
  }

  /** Inputs up to this one are shown. */
  answered(n: number | undefined): void {
    if (n !== undefined) this.unanswered = this.unanswered.filter((input) => input.n > n);
  }

  /** Whether the newest input is not shown yet. */
  get isBehind(): boolean {
    return this.unanswered.length > 0;
  }

  get isBusy(): boolean {
    return this.isBehind && performance.now() - this.unanswered[0].at > BUSY_MS;
  }

  /** Ask for something; the promise keeps the answer, and the number by which it can be cancelled. */
  ask(kind: string, what: Table, progress?: (part: number) => void): Promise<Message> & { id: number } {
    this.beforeAsking();
    const id = ++this.asked;
    const answer = new Promise<Message>((done, failed) => {
      this.waiting.set(id, { done, failed, progress });
      this.send({ kind, id, ...what });
    });
    return Object.assign(answer, { id });
  }

  /** Ask for something; what went wrong is shown, and the answer is null. */
  tried(kind: string, what: Table, level = "warning"): Promise<Message | null> {
    const { field } = this.notices;
    return this.ask(kind, what).catch((error) => {
      this.notices.add(error.message, level, field);
      return null;
    });
  }

  /** Take an answer. */
  reply(message: Message): void {
    const waiting = this.waiting.get(message.id);
    this.waiting.delete(message.id);
    if (message.error) waiting?.failed(new Error(message.error));
    else waiting?.done(message);
  }

  progress(message: Message): void {
    this.waiting.get(message.id)?.progress?.(message.done);
  }

  /** Nothing that was asked over a lost connection is answered any more. */
  reconnected(): void {
    this.unanswered = [];
    for (const { failed } of this.waiting.values()) failed(new Error("the connection was lost"));
    this.waiting.clear();
  }
}
