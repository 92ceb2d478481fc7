// Ties the parts together: messages in, frames to the picture, the panels around it.

import { tableOf } from "./camera";
import { listen } from "./gestures";
import { connectionBox } from "./connection";
import { Highlight } from "./highlight";
import { listenToKeys } from "./keys";
import { build } from "./layout";
import { Legend } from "./legend";
import { navigate } from "./navigation";
import { Notices } from "./notices";
import { Overlay } from "./overlay";
import { exchange } from "./scenes";
import { linkOf } from "./share";
import { Server } from "./server";
import { Stage } from "./stage";
import { Store } from "./store";
import { fromBase64, type FrameHead, type Message, type Model, type Table, type VolumeInfo } from "./wire";

const PROTOCOL = 1;

/** Show the explorer in an element, until what is returned is called. */
export function explore(model: Model, el: HTMLElement): () => void {
  const notices = new Notices();
  const server = new Server(model, notices);
  const stage = new Stage((frame) => server.send({ kind: "seen", frame }), decorate);
  const store = new Store((m) => server.send(m), () => notices.remember((changedBy = server.number())), (callback) => requestAnimationFrame(callback));
  const overlay = new Overlay(stage, (axis) => navigation.side(axis));
  const legend = new Legend(stage, store, server);
  const rests = (): boolean => !navigation.moving && !server.isBehind && root.dataset.exact === "true";
  const highlight: Highlight = new Highlight(server, rests, (values) => {
    if (values === null) delete root.dataset.highlight;
    else root.dataset.highlight = values;
  });
  const navigation = navigate(stage, overlay, highlight, server, notices, Boolean(model.follows), (view) => {
    layout.camera(view);
    judge();
  });
  /** The document as this page shows it: others may have moved its camera. */
  const shown = (): Table => ({ ...store.document, ...(stage.view ? { camera: tableOf(stage.view) } : {}), time: store.time || undefined });
  const scenes = exchange(store, server, notices, shown, () => (root.closest(".vlm-page") ? location.origin + location.pathname : ""));
  const link = connectionBox(model, async () => (server.welcome ? (await linkOf(shown(), "")).slice(1) : ""));
  const layout = build({ notices, server, stage, store, overlay, highlight, navigation, scenes }, legend.element, link);
  const { root, probe } = layout;
  let changedBy = 0;
  let lastSize = "";

  function hello(): void {
    const now = size();
    lastSize = JSON.stringify(now);
    server.send({ kind: "hello", protocol: PROTOCOL, ...now, leader: !model.follows });
    if (document.hidden) visible();
  }

  function visible(): void {
    server.send({ kind: "visible", on: !document.hidden });
  }

  function connection(state: string, reason?: string): void {
    link.show(state, reason);
    root.dataset.connection = state;
    if (state !== "open") return;
    stage.restart();
    server.reconnected();
    hello();
  }

  function receive(message: Message, buffers?: any[]): void {
    switch (message.kind) {
      case "welcome":
        return welcomed(message);
      case "document":
        store.receive(message);
        return server.answered(store.isAhead ? message.n : Math.max(message.n ?? 0, changedBy));
      case "frame":
        return void frame(message as FrameHead, asBytes(buffers?.[0]));
      case "opening":
        return layout.opening(message.name);
      case "volume":
        server.welcome = { ...server.welcome!, volume: message.volume };
        return layout.described();
      case "reply":
        return server.reply(message);
      case "progress":
        return server.progress(message);
      case "notice":
        if (message.n !== undefined) store.forget(message.n);
        return notices.add(message.text, message.level, notices.about(message.n));
    }
  }

  function welcomed(message: Message): void {
    const again = server.welcome !== null;
    const before = server.info;
    server.welcome = message;
    for (const [name, table] of Object.entries(message.colormaps ?? {})) {
      stage.tables.set(name, fromBase64(table as string));
    }
    const restarted = again && message.revision < store.revision;
    const mine = shown();
    if (restarted && other(before!, message.volume) && root.closest(".vlm-page")) return location.reload();
    store.receive(message);
    // A server that was started anew has the file's scene; what was on the screen goes back to it.
    if (restarted) {
      scenes.put(mine, "restored");
      notices.add("The server was started anew: what was on this page was sent to it.");
    } else if (again) {
      store.resend();
      navigation.resume();
    }
    layout.welcomed();
    if (!again) for (const note of message.notes ?? []) notices.add(note, "warning");
    resized();
    if (!again && model.link?.includes("scene=")) scenes.load(model.link).catch((error) => notices.add(error.message, "error"));
  }

  async function frame(head: FrameHead, bytes: Uint8Array): Promise<void> {
    server.answered(head.n);
    const wasFlat = stage.isFlat;
    try {
      if (!(await stage.take(head, bytes, navigation.moving))) return;
    } catch (error) {
      server.send({ kind: "seen", frame: head.number });
      return notices.add(`a frame could not be read: ${(error as Error).message}`, "error");
    }
    if (wasFlat && !stage.isFlat) notices.add("This camera can be turned, not moved or zoomed: its picture is no plane.");
    navigation.shown(head);
    Object.assign(root.dataset, { n: head.n, frame: head.number });
    judge();
    layout.framed(head);
    highlight.renew();
  }

  /** Say what the frame is that is shown: exact is only one of the newest document and view. */
  function judge(): void {
    const { head } = stage;
    if (!head) return;
    const newest = head.revision >= store.painted && !store.awaitsPicture && navigation.has(head);
    root.dataset.exact = String(head.exact && newest);
    layout.badge(head, newest);
  }

  function size(): { size: [number, number]; scale: number } {
    const { clientWidth, clientHeight } = layout.stage;
    return { size: [Math.max(1, clientWidth), Math.max(1, clientHeight)], scale: window.devicePixelRatio || 1 };
  }

  function resized(): void {
    const now = size();
    stage.resize(now.size[0] * now.scale, now.size[1] * now.scale);
    // In a notebook the cell has no size yet when hello is said.
    if (!server.welcome || JSON.stringify(now) === lastSize) return;
    lastSize = JSON.stringify(now);
    server.input("size", now);
  }

  /** The document has changed. */
  function updated(): void {
    const image = store.document.image ?? {};
    if (image !== stage.image) {
      stage.image = image;
      stage.redraw();
    }
    layout.update();
    judge();
    legend.draw();
  }

  /** The picture was drawn. */
  function decorate(): void {
    if (!server.info) return;
    overlay.draw(server.info);
    legend.draw();
    root.dataset.ready = "true";
  }

  el.append(root);
  notices.follow(root);
  server.beforeAsking = () => {
    navigation.flush();
    store.flush();
  };
  listen(stage, {
    view: () => stage.view,
    look: navigation.look,
    click: (place) => void probe.at(place),
    doubleClick: (place) => void probe.at(place).then(probe.turnAbout),
    freely: () => navigation.freely,
  });
  store.listen(updated);
  const observer = new ResizeObserver(resized);
  observer.observe(layout.stage);
  model.on("msg:custom", receive);
  model.on("connection", connection);
  document.addEventListener("visibilitychange", visible);
  const timer = window.setInterval(() => link.busy(server.isBusy), 250);
  const deafen = listenToKeys(layout.keys, root, stage.canvas);
  hello();
  return () => {
    deafen();
    model.off?.("msg:custom", receive);
    model.off?.("connection", connection);
    document.removeEventListener("visibilitychange", visible);
    observer.disconnect();
    clearInterval(timer);
    root.remove();
  };
}

/** Whether two volumes have other fields, or are elsewhere: a scene of one is none of the other. */
function other(a: VolumeInfo, b: VolumeInfo): boolean {
  const key = ({ bounds, fields }: VolumeInfo) => JSON.stringify([bounds, fields.map(({ name, unit }) => [name, unit])]);
  return key(a) !== key(b);
}

function asBytes(buffer: any): Uint8Array {
  if (buffer instanceof Uint8Array) return buffer;
  if (ArrayBuffer.isView(buffer)) return new Uint8Array(buffer.buffer, buffer.byteOffset, buffer.byteLength);
  return new Uint8Array(buffer ?? 0);
}
