// The page of the server: makes anywidget's model out of a websocket, and keeps it connected.

// @ts-ignore: beside this file when both are built
import explorer from "./explorer.js";
import { type Message, type Model, unpack } from "./wire";

const TOKEN = "voluminous-token";
const SHORTEST_MS = 250;
const LONGEST_MS = 8000;

/** The token comes behind the #, which is sent to nobody, and does not stay in the address; nor does a scene. */
const link = location.hash;
const given = /[#&]token=([^&]+)/.exec(link)?.[1];
if (given) sessionStorage.setItem(TOKEN, given);
if (link) history.replaceState(null, "", location.pathname + location.search);
// Another link, pasted into the address of this page.
addEventListener("hashchange", () => location.reload());

class Socket implements Model {
  readonly follows = new URLSearchParams(location.search).has("follow");
  readonly link = link;
  private socket: WebSocket | null = null;
  private listeners = new Map<string, ((...args: any[]) => void)[]>();
  private wait = SHORTEST_MS;
  private retry = 0;

  constructor(
    private url: string,
    private token: string,
  ) {
    // Back from sleep or from another network: at once.
    addEventListener("online", () => this.again(0));
    document.addEventListener("visibilitychange", () => document.hidden || this.again(0));
  }

  connect(): void {
    clearTimeout(this.retry);
    const socket = new WebSocket(this.url, ["voluminous.v1", `token.${this.token}`]);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.wait = SHORTEST_MS;
      this.emit("connection", "open");
    };
    socket.onmessage = (event) => {
      if (typeof event.data === "string") return this.emit("msg:custom", JSON.parse(event.data), []);
      const { message, bytes } = unpack(new Uint8Array(event.data));
      this.emit("msg:custom", message, [bytes]);
    };
    socket.onclose = () => {
      if (socket !== this.socket) return;
      this.socket = null;
      this.emit("connection", "lost");
      this.again(this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_MS);
    };
  }

  private again(after: number): void {
    if (this.socket) return;
    clearTimeout(this.retry);
    this.retry = window.setTimeout(() => this.connect(), after);
  }

  on(event: string, callback: (...args: any[]) => void): void {
    this.listeners.set(event, [...(this.listeners.get(event) ?? []), callback]);
  }

  off(event: string, callback?: (...args: any[]) => void): void {
    this.listeners.set(event, callback ? (this.listeners.get(event) ?? []).filter((c) => c !== callback) : []);
  }

  private emit(event: string, ...args: any[]): void {
    for (const callback of this.listeners.get(event) ?? []) callback(...args);
  }

  /** What cannot be sent is dropped: changes of the document are kept, and sent again, by the store. */
  send(content: Message): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(content));
  }
}

const address = new URL("ws", location.href);
address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
address.hash = "";
const model = new Socket(address.href, sessionStorage.getItem(TOKEN) ?? "");
const el = document.createElement("main");
document.body.classList.add("vlm-page");
document.body.append(el);
explorer.render({ model, el });
model.connect();
