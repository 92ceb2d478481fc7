// Makes elements. Styles are in explorer.css alone: the page's security policy allows no other.

/** Right and up of the arrow keys. */
export const ARROWS: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

type Child = Node | string | null | undefined | false;
type Props = { [name: string]: any };

function fill<E extends Element>(element: E, props: Props, children: Child[]): E {
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else element.setAttribute(name, String(value));
  }
  element.append(...(children.filter(Boolean) as (Node | string)[]));
  return element;
}

export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  return fill(document.createElement(tag), props, children);
}

export function svg<K extends keyof SVGElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): SVGElementTagNameMap[K] {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), props, children);
}

/** Paths of the icons, drawn as lines in a square of 16. */
const ICONS: Record<string, string> = {
  undo: "M3 6h7a3.5 3.5 0 0 1 0 7H6M3 6l3-3M3 6l3 3",
  redo: "M13 6H6a3.5 3.5 0 0 0 0 7h4M13 6l-3-3M13 6l-3 3",
  fit: "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4M6 6h4v4H6z",
  home: "M2 8l6-5 6 5M4 7v6h8V7",
  cube: "M8 2l5 3v6l-5 3-5-3V5zM8 8v6M8 8l5-3M8 8L3 5",
  eye: "M1.5 8S4 3.5 8 3.5 14.5 8 14.5 8 12 12.5 8 12.5 1.5 8 1.5 8zM8 6a2 2 0 1 0 0 4 2 2 0 1 0 0-4",
  hidden: "M2 2l12 12M1.5 8S4 3.5 8 3.5 14.5 8 14.5 8 12 12.5 8 12.5 1.5 8 1.5 8z",
  save: "M8 2v8M5 7l3 3 3-3M2.5 12v2h11v-2",
  help: "M6 6a2 2 0 1 1 3 1.7c-.7.4-1 .8-1 1.8M8 12v.4M8 1.5a6.5 6.5 0 1 0 0 13 6.5 6.5 0 1 0 0-13",
  plus: "M8 3v10M3 8h10",
  copy: "M6 6h7v7H6zM3 10V3h7",
  bin: "M3 4h10M6.500 4V2.500h3V4M4.500 4l.6 9.500h5.800l.6-9.500",
  play: "M5 3l8 5-8 5z",
  pause: "M5 3v10M11 3v10",
  four: "M2 2h5v5H2zM9 2h5v5H9zM2 9h5v5H2zM9 9h5v5H9z",
  ball: "M8 2a6 6 0 1 0 0 12A6 6 0 1 0 8 2M2 8c3 2.500 9 2.500 12 0M8 2c-3 3-3 9 0 12",
};

export function icon(name: string): SVGSVGElement {
  return svg("svg", { viewBox: "0 0 16 16", class: "vlm-icon", "aria-hidden": "true" }, svg("path", { d: ICONS[name] }));
}

/** A button with an icon, words, or both; `title` says what it does and by which key. */
export function button(label: string, title: string, onclick: (event: Event) => void, image?: string): HTMLButtonElement {
  const made = h("button", { type: "button", title, onclick }, image && icon(image), label && h("span", {}, label));
  if (!label) made.setAttribute("aria-label", title);
  return made;
}

let serial = 0;
// Several explorers may be in one notebook, each with its own copy of this module.
const copy = Math.random().toString(36).slice(2, 8);

/** An id that no other element has. */
export const newId = (): string => `vlm-${copy}-${++serial}`;

/** Replace the children of an element. */
export function refill(element: Element, ...children: Child[]): void {
  element.replaceChildren(...(children.filter(Boolean) as (Node | string)[]));
}
