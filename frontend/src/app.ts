// Ties the parts together: messages in and out, the camera, the picture, the panels around it.

import { fit, fromSide, tableOf, type View } from "./camera";
import { listen } from "./gestures";
import { Highlight } from "./highlight";
import { keyTable, listenToKeys } from "./keys";
import { build } from "./layout";
import { Legend } from "./legend";
import { Overlay } from "./overlay";
import { linkOf, sceneOf, SECTIONS } from "./share";
import { Stage } from "./stage";
import { Store } from "./store";
import { h } from "./ui/dom";
import { pretty } from "./ui/format";
import { fromBase64, type FrameHead, type Message, type Model, type Table, type Vec3, type VolumeInfo } from "./wire";

export const PROTOCOL = 1;
const BUSY_MS = 500;

export class App {
  readonly stage = new Stage((frame) => this.send({ kind: "seen", frame }), () => this.decorate());
  readonly store = new Store((m) => this.send(m), () => (this.changedBy = this.number()), (callback) => requestAnimationFrame(callback));
  readonly overlay = new Overlay(this.stage, (axis) => this.change((view) => fromSide(view, axis)));
  readonly legend = new Legend(this);
  readonly highlight = new Highlight(this);
  readonly keys = keyTable(this);
  readonly layout = build(this);
  readonly root = this.layout.root;
  readonly follows: boolean;
  info: VolumeInfo | null = null;
  welcome: Message | null = null;
  /** Last answer to a click. */
  probe: Message | null = null;
  freely = false;
  private home: View | null = null;
  private inputs = 0;
  private changedBy = 0;
  private told = "";
  private looked = 0;
  /** A camera was asked for and not shown before the connection broke. */
  private lostLook = false;
  private moving = false;
  private wanted: { view: View; moving: boolean } | null = null;
  private waiting = new Map<number, { done(m: Message): void; failed(e: Error): void; progress?(part: number): void }>();
  private asked = 0;
  private unanswered: { n: number; at: number }[] = [];
  private closing: (() => void)[] = [];

  constructor(private model: Model, el: HTMLElement) {
    this.follows = Boolean(model.follows);
    el.append(this.root);
    listen(this.stage, {
      view: () => this.stage.view,
      look: (view, moving) => this.look(view, moving),
      click: (place) => void this.probeAt(place),
      doubleClick: (place) => void this.probeAt(place).then(() => this.turnAboutProbe()),
      freely: () => this.freely,
    });
    this.store.listen(() => this.updated());
    const observer = new ResizeObserver(() => this.resized());
    observer.observe(this.layout.stage);
    const message = (content: Message, buffers?: any[]) => void this.receive(content, buffers?.[0]);
    const connection = (state: string) => this.connection(state);
    model.on("msg:custom", message);
    model.on("connection", connection);
    const visible = () => this.send({ kind: "visible", on: !document.hidden });
    document.addEventListener("visibilitychange", visible);
    const timer = window.setInterval(() => this.watch(), 250);
    this.closing = [
      listenToKeys(this),
      () => model.off?.("msg:custom", message),
      () => model.off?.("connection", connection),
      () => document.removeEventListener("visibilitychange", visible),
      () => observer.disconnect(),
      () => clearInterval(timer),
    ];
    this.hello();
  }

  close(): void {
    for (const end of this.closing) end();
    this.root.remove();
  }

  // Messages

  send(message: Message): void {
    this.model.send(message);
  }

  /** Ask for something; the promise keeps the answer, and the number by which it can be cancelled. */
  ask(kind: string, what: Table, progress?: (part: number) => void): Promise<Message> & { id: number } {
    const id = ++this.asked;
    const answer = new Promise<Message>((done, failed) => {
      this.waiting.set(id, { done, failed, progress });
      this.send({ kind, id, ...what });
    });
    return Object.assign(answer, { id });
  }

  /** Ask for something; what went wrong is shown, and the answer is null. */
  tried(kind: string, what: Table, level = "warning"): Promise<Message | null> {
    return this.ask(kind, what).catch((error) => {
      this.notice(error.message, level);
      return null;
    });
  }

  /** Whether the exact picture of the newest input is there. */
  get rests(): boolean {
    return !this.moving && !this.isBehind && this.root.dataset.exact === "true";
  }

  private number(): number {
    const n = ++this.inputs;
    this.unanswered.push({ n, at: performance.now() });
    return n;
  }

  private hello(): void {
    const size = this.size();
    this.told = JSON.stringify(size);
    this.send({ kind: "hello", protocol: PROTOCOL, ...size, leader: !this.follows });
    if (document.hidden) this.send({ kind: "visible", on: false });
  }

  private connection(state: string): void {
    this.layout.connection(state);
    if (state !== "open") return;
    this.lostLook = this.unanswered.some(({ n }) => n === this.looked);
    this.stage.restart();
    this.unanswered = [];
    for (const { failed } of this.waiting.values()) failed(new Error("the connection was lost"));
    this.waiting.clear();
    this.hello();
  }

  private async receive(message: Message, buffer?: any): Promise<void> {
    switch (message.kind) {
      case "welcome":
        return this.welcomed(message);
      case "document":
        this.store.receive(message);
        return this.answered(this.store.isAhead ? message.n : Math.max(message.n ?? 0, this.changedBy));
      case "frame":
        return this.frame(message as FrameHead, asBytes(buffer));
      case "reply": {
        const waiting = this.waiting.get(message.id);
        this.waiting.delete(message.id);
        if (message.error) waiting?.failed(new Error(message.error));
        else waiting?.done(message);
        return;
      }
      case "progress":
        return this.waiting.get(message.id)?.progress?.(message.done);
      case "notice":
        if (message.n !== undefined) this.store.forget(message.n);
        return this.notice(message.text, message.level);
    }
  }

  private welcomed(message: Message): void {
    const again = this.welcome !== null;
    this.welcome = message;
    this.info = message.volume;
    for (const [name, table] of Object.entries(message.colormaps ?? {})) {
      this.stage.tables.set(name, fromBase64(table as string));
    }
    const restarted = again && message.revision < this.store.revision;
    const { view } = this.stage;
    const mine: Table = { ...this.store.document, ...(view ? { camera: tableOf(view) } : {}) };
    this.store.receive(message);
    // A server that was started anew has the file's scene; what was on the screen goes back to it.
    if (restarted) {
      this.put(mine, "restored");
    } else if (again) {
      this.store.resend();
      if (this.lostLook && view) this.look(view, false);
    }
    this.layout.welcomed();
    this.resized();
    if (!again && this.model.link?.includes("scene=")) this.load(this.model.link).catch((error) => this.notice(error.message, "error"));
  }

  /** Take media, camera, render and image of a scene: one step of the history. */
  private put(scene: Table, label: string): void {
    this.store.set(SECTIONS.filter((name) => scene[name] !== undefined).map((name) => [name, scene[name]]), label);
  }

  /** Show the scene of a link, or of the text of a scene file. */
  async load(text: string): Promise<void> {
    const scene = await sceneOf(text);
    if (scene) this.put(scene, "shared scene");
    else await this.ask("load", { text });
  }

  private async frame(head: FrameHead, bytes: Uint8Array): Promise<void> {
    this.answered(head.n);
    const wasFlat = this.stage.isFlat;
    try {
      if (!(await this.stage.take(head, bytes, this.moving))) return;
    } catch (error) {
      this.send({ kind: "seen", frame: head.number });
      return this.notice(`a frame could not be read: ${(error as Error).message}`, "error");
    }
    const { frameView, view } = this.stage;
    if (wasFlat && !this.stage.isFlat) this.notice("This camera can be turned, not moved or zoomed: its picture is no plane.", "info");
    this.home ??= frameView;
    // Others may have moved the camera; what was asked for here is not overruled by older frames.
    if (!this.moving && !this.wanted && head.n >= this.looked && frameView) {
      this.stage.view = { ...frameView, pivot: view?.pivot ?? null };
    }
    this.layout.badge(head);
    Object.assign(this.root.dataset, { n: head.n, frame: head.number, exact: head.exact });
    this.highlight.renew();
  }

  private answered(n: number | undefined): void {
    if (n !== undefined) this.unanswered = this.unanswered.filter((input) => input.n > n);
  }

  private watch(): void {
    const oldest = this.unanswered[0];
    this.layout.busy(oldest !== undefined && performance.now() - oldest.at > BUSY_MS);
  }

  // Camera

  /** Show another view: at once by moving the last frame, and rightly when the server has drawn it. */
  look(view: View, moving: boolean): void {
    if (this.follows) return;
    this.stage.view = view;
    this.moving = moving;
    this.highlight.hide();
    this.overlay.pivot = view.pivot;
    this.stage.redraw();
    const waiting = this.wanted !== null;
    this.wanted = { view, moving };
    // One input for each frame of the screen at most: the newest.
    if (!waiting) requestAnimationFrame(() => this.sendLook());
  }

  private sendLook(): void {
    if (!this.wanted) return;
    const { view, moving } = this.wanted;
    this.wanted = null;
    this.looked = this.number();
    this.send({ kind: "look", n: this.looked, camera: tableOf(view), moving });
    this.layout.camera(view);
  }

  change(how: (view: View) => View, moving = false): void {
    if (this.stage.view) this.look(how(this.stage.view), moving);
  }

  fit(): void {
    if (this.info) this.change((view) => fit(view, this.info!.bounds, this.stage.aspect));
  }

  reset(): void {
    if (this.home) this.look({ ...this.home, pivot: null }, false);
  }

  switchFreely(): void {
    this.freely = !this.freely;
    this.announce(this.freely ? "Trackball" : "Turntable");
    this.layout.camera(this.stage.view);
  }

  private size(): { size: [number, number]; scale: number } {
    const { clientWidth, clientHeight } = this.layout.stage;
    return { size: [Math.max(1, clientWidth), Math.max(1, clientHeight)], scale: window.devicePixelRatio || 1 };
  }

  private resized(): void {
    const { size, scale } = this.size();
    this.stage.resize(size[0] * scale, size[1] * scale);
    // In a notebook the cell has no size yet when hello is said.
    const now = JSON.stringify({ size, scale });
    if (!this.welcome || now === this.told) return;
    this.told = now;
    this.send({ kind: "size", n: this.number(), size, scale });
  }

  // Clicks

  async probeAt(place: [number, number]): Promise<void> {
    const at = this.stage.fromPlace(place);
    const reply = at && (await this.tried("probe", { x: at[0], y: at[1] }));
    if (!reply) return;
    this.probe = reply;
    this.overlay.probed = reply.point ?? null;
    this.layout.probed();
    this.stage.redraw();
  }

  turnAboutProbe(): void {
    const point = this.probe?.point as Vec3 | null | undefined;
    if (!point) return this.notice("Nothing shines there, so there is no point to rotate about.", "info");
    this.overlay.pivot = point;
    this.overlay.probed = null;
    this.change((view) => ({ ...view, pivot: point }));
    this.announce("Rotating about the marked point");
  }

  // What is around the picture

  private updated(): void {
    const image = this.store.document.image ?? {};
    if (image !== this.stage.image) {
      this.stage.image = image;
      this.stage.redraw();
    }
    this.layout.update();
    this.legend.draw();
  }

  private decorate(): void {
    if (!this.info) return;
    this.overlay.draw(this.info);
    this.legend.draw();
    this.root.dataset.ready = "true";
  }

  /** Another file of a series. */
  time(index: number): void {
    this.send({ kind: "time", n: this.number(), index });
  }

  /** Whether the server has not yet shown the newest input. */
  get isBehind(): boolean {
    return this.unanswered.length > 0;
  }

  undo(times = 1): void {
    this.store.flush();
    if (!this.store.undo.length && !this.store.isAhead) return;
    for (let i = 0; i < times; i++) this.send({ kind: "undo", n: this.number() });
  }

  redo(times = 1): void {
    if (!this.store.redo.length) return;
    for (let i = 0; i < times; i++) this.send({ kind: "redo", n: this.number() });
  }

  /** Change the exposure by stops, from what is shown now. */
  expose(stops: number): void {
    const now = Number(this.store.document.image?.exposure ?? this.stage.head?.exposure ?? 1);
    this.store.set([["image.exposure", now * 2 ** stops]], "exposure");
    this.announce(`Exposure ${pretty(now * 2 ** stops)}`);
  }

  notice(text: string, level = "info"): void {
    this.layout.notice(text, level);
  }

  /** Tell those who do not see the picture. */
  announce(text: string): void {
    this.layout.live.textContent = text;
  }

  /** Put text where it can be pasted. */
  async copy(text: string, what: string): Promise<void> {
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // Without a secure context there is only the old way.
      const area = h("textarea", { class: "vlm-offscreen" }, text);
      this.root.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    this.notice(`${what} copied`, "info");
  }

  async copyLink(): Promise<void> {
    const page = this.root.closest(".vlm-page") ? location.origin + location.pathname : "";
    await this.copy(await linkOf(this.store.document, page), "Link");
  }

  async copyScene(what: "python" | "toml"): Promise<void> {
    const reply = await this.tried("export", { what }, "error");
    if (reply) await this.copy(reply.text, what === "python" ? "Python" : "Scene (TOML)");
  }
}

function asBytes(buffer: any): Uint8Array {
  if (buffer instanceof Uint8Array) return buffer;
  if (ArrayBuffer.isView(buffer)) return new Uint8Array(buffer.buffer, buffer.byteOffset, buffer.byteLength);
  return new Uint8Array(buffer ?? 0);
}
