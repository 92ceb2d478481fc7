// A scene as a link: media, projection, camera, render, image and slices of the document, deflated, behind the # of an
// address, which is sent to nobody. Never the token, and never the volume.

import { inflate } from "./half";
import { fromBase64, type Table, toBase64 } from "./wire";

export const SECTIONS = ["medium", "project", "camera", "render", "image", "measures", "slices", "time"];

export async function linkOf(document: Table, page: string): Promise<string> {
  const json = JSON.stringify(Object.fromEntries(SECTIONS.map((name) => [name, document[name]])));
  const stream = new Blob([json]).stream().pipeThrough(new CompressionStream("deflate"));
  const packed = toBase64(new Uint8Array(await new Response(stream).arrayBuffer()));
  return `${page}#scene=${packed.replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "")}`;
}

/** The scene of a link; null if a text is none. */
export async function sceneOf(text: string): Promise<Table | null> {
  const packed = /^\S*[#&]scene=([\w-]+)/.exec(text)?.[1];
  if (!packed) return null;
  try {
    const json = await inflate(fromBase64(packed.replace(/-/g, "+").replace(/_/g, "/")));
    const scene = JSON.parse(new TextDecoder().decode(json));
    return Object.fromEntries(SECTIONS.filter((name) => scene[name]).map((name) => [name, scene[name]]));
  } catch {
    throw new Error("this link is cut off or no link to a scene");
  }
}
