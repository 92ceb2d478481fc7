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

const NO_TOKEN = "This page has no token: its address was not whole.";
const OTHER_TOKEN = "The server does not take this page's token: it was started anew, or the address was not whole.";

class Socket implements Model {
  readonly follows = new URLSearchParams(location.search).has("follow");
  readonly link = link;
  private socket: WebSocket | null = null;
  private listeners = new Map<string, ((...args: any[]) => void)[]>();
  private wait = SHORTEST_MS;
  private retry = 0;
  /** Another page of the server, if this one's does not take the token that was pasted. */
  private elsewhere = "";

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
    let opened = false;
    socket.onopen = () => {
      opened = true;
      this.elsewhere = "";
      this.wait = SHORTEST_MS;
      this.emit("connection", "open");
    };
    socket.onmessage = (event) => {
      if (typeof event.data === "string") return this.emit("msg:custom", JSON.parse(event.data), []);
      const { message, bytes } = unpack(new Uint8Array(event.data));
      this.emit("msg:custom", message, [bytes]);
    };
    socket.onclose = ({ reason }) => {
      if (socket !== this.socket) return;
      this.socket = null;
      this.again(this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_MS);
      if (opened) this.emit("connection", "lost", reason);
      else void this.explain();
    };
  }

  /** A browser does not say why a socket was not opened: whether the server is there is asked apart. */
  private async explain(): Promise<void> {
    const there = await fetch("icon.svg", { cache: "no-store" }).then((r) => r.ok && /svg/.test(r.headers.get("content-type") ?? ""), () => false);
    if (this.socket?.readyState === WebSocket.OPEN) return;
    if (this.elsewhere) return location.assign(this.elsewhere);
    if (there) this.emit("connection", "refused", this.token ? OTHER_TOKEN : NO_TOKEN);
    else this.emit("connection", "lost");
  }

  renew(given: string, scene: string): boolean {
    const token = /[#&]token=([^&\s]+)/.exec(given)?.[1] ?? /^[\w-]{20,}$/.exec(given)?.[0];
    if (!token) return false;
    sessionStorage.setItem(TOKEN, (this.token = token));
    // Here first: behind a tunnel the address that was printed is another one.
    const there = given.split("#")[0];
    const other = /^https?:/.test(there) && there !== location.href.split(/[#?]/)[0];
    this.elsewhere = other ? `${there}#token=${token}${scene && `&${scene}`}` : "";
    this.socket = null;
    this.connect();
    return true;
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
