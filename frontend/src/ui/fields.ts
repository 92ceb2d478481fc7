// Fields of the panels: numbers, sliders, texts, choices. Each has `update`, which shows another
// value without telling anybody, and leaves alone what is being typed.

import { h } from "./dom";
import { typed } from "./format";

export interface Field<T> {
  element: HTMLElement;
  update(value: T): void;
}

type Changed<T> = (value: T, moving: boolean) => void;
let serial = 0;
// Several explorers may be in one notebook, each with its own copy of this module.
const own = Math.random().toString(36).slice(2, 8);

/** An id that no other element has. */
export const newId = (): string => `vlm-${own}-${++serial}`;

export function labelled(label: string, input: HTMLElement, after?: HTMLElement | string, hint?: string): HTMLElement {
  if (!input.id) input.id = newId();
  return h("div", { class: "vlm-row", title: hint }, h("label", { for: input.id }, label), input, after ?? null);
}

/** A number that is typed, or changed by the arrow keys (Shift: ten times as much). */
export function numberField(label: string, unit: string, changed: Changed<number>, hint?: string): Field<number | null> {
  const input = h("input", { type: "text", inputmode: "decimal", class: "vlm-number", spellcheck: "false" });
  const after = h("span", { class: "vlm-unit" }, unit);
  let value: number | null = null;
  const step = (by: number, moving: boolean) => {
    const from = value ?? 0;
    value = Number((from + by * (10 ** Math.floor(Math.log10(Math.abs(from) || 1)) / 10)).toPrecision(6));
    input.value = typed(value);
    changed(value, moving);
  };
  input.addEventListener("keydown", (event) => {
    const way = event.key === "ArrowUp" ? 1 : event.key === "ArrowDown" ? -1 : 0;
    if (!way) return;
    event.preventDefault();
    step(event.shiftKey ? 10 * way : way, false);
  });
  input.addEventListener("change", () => {
    const read = Number(input.value.replace(",", ".").replace("−", "-"));
    if (input.value.trim() === "" || !Number.isFinite(read)) {
      input.setAttribute("aria-invalid", "true");
      return;
    }
    input.removeAttribute("aria-invalid");
    value = read;
    changed(read, false);
  });
  return {
    element: labelled(label, input, after, hint),
    update(next) {
      value = next;
      if (!input.matches(":focus")) {
        input.value = next === null ? "" : typed(next);
        input.removeAttribute("aria-invalid");
      }
    },
  };
}

/** A slider of the browser, with its value in words beside it. */
export function slider(
  label: string,
  [low, high, step]: [number, number, number],
  words: (value: number) => string,
  changed: Changed<number>,
  hint?: string,
): Field<number> {
  const input = h("input", { type: "range", min: low, max: high, step });
  const told = h("output", { class: "vlm-told" });
  const show = (value: number) => {
    told.textContent = words(value);
    input.setAttribute("aria-valuetext", words(value));
  };
  let held = false;
  input.addEventListener("input", () => {
    held = true;
    show(Number(input.value));
    changed(Number(input.value), true);
  });
  input.addEventListener("change", () => {
    held = false;
    changed(Number(input.value), false);
  });
  return {
    element: labelled(label, input, told, hint),
    update(value) {
      if (held) return;
      input.value = String(value);
      show(value);
    },
  };
}

export function textField(label: string, changed: (value: string) => void, hint?: string, placeholder = ""): Field<string> {
  const input = h("input", { type: "text", spellcheck: "false", autocomplete: "off", placeholder });
  input.addEventListener("change", () => changed(input.value.trim()));
  return {
    element: labelled(label, input, undefined, hint),
    update(value) {
      if (!input.matches(":focus")) input.value = value;
    },
  };
}

export function choice(label: string, options: string[], changed: (value: string) => void, hint?: string): Field<string> & { options(list: string[]): void } {
  const input = h("select");
  let known = "";
  const options_ = (list: string[]) => {
    if (list.join() === known) return;
    known = list.join();
    input.replaceChildren(...list.map((name) => h("option", { value: name }, name)));
  };
  options_(options);
  input.addEventListener("change", () => changed(input.value));
  return {
    element: labelled(label, input, undefined, hint),
    update: (value) => {
      if (![...input.options].some((o) => o.value === value)) input.append(h("option", { value }, value));
      input.value = value;
    },
    options: options_,
  };
}

export function toggle(label: string, changed: (on: boolean) => void, hint?: string): Field<boolean> {
  const input = h("input", { type: "checkbox" });
  input.addEventListener("change", () => changed(input.checked));
  return {
    element: h("label", { class: "vlm-toggle", title: hint }, input, h("span", {}, label)),
    update: (on) => void (input.checked = on),
  };
}
