// Scenes that come from elsewhere or go there: links, files, Python.

import type { Notices } from "./notices";
import type { Server } from "./server";
import { linkOf, sceneOf, SECTIONS } from "./share";
import type { Store } from "./store";
import type { Table } from "./wire";

export type Scenes = ReturnType<typeof exchange>;

/**
 * @param shown the document as this page shows it
 * @param page the address of the page; empty in a notebook
 */
export function exchange(store: Store, server: Server, notices: Notices, shown: () => Table, page: () => string) {
  /** Take what a scene has, but for its volume: one step of the history. Without a projection it shows media. */
  const put = ({ time, ...given }: Table, label: string) => {
    const scene: Table = { project: {}, ...given };
    const names = [...SECTIONS, "bookmarks"].filter((name) => scene[name] !== undefined);
    store.set(names.map((name) => [name, scene[name]]), label);
    if (time !== undefined) server.input("time", { index: time });
  };
  return {
    put,
    /** Show the scene of a link, or of the text of a scene file. */
    async load(text: string): Promise<void> {
      const scene = await sceneOf(text);
      if (scene) put(scene, "shared scene");
      else await server.ask("load", { text });
    },
    async copyLink(): Promise<void> {
      await notices.copy(await linkOf(shown(), page()), "Link");
    },
    async copy(what: "python" | "toml"): Promise<void> {
      const reply = await server.tried("export", { what }, "error");
      if (reply) await notices.copy(reply.text, what === "python" ? "Python" : "Scene (TOML)");
    },
  };
}
