// Fields of the panels: numbers, sliders, texts, choices. Each has `update`, which shows another
// value without telling anybody, and leaves alone what is being typed.

import { ARROWS, h, newId } from "./dom";
import { typed } from "./format";

export interface Field<T> {
  element: HTMLElement;
  update(value: T): void;
}

type Changed<T> = (value: T, moving: boolean) => void;

/** Say below a field what is wrong with it; an empty text takes that back. */
export function complain(input: HTMLElement, text: string): void {
  const row = input.closest(".vlm-row") ?? input;
  let box = row.nextElementSibling;
  if (!box?.classList.contains("vlm-wrong")) {
    if (!text) return;
    row.after((box = h("p", { class: "vlm-wrong", role: "alert", id: newId() })));
  }
  box.textContent = text;
  if (text) {
    input.setAttribute("aria-invalid", "true");
    input.setAttribute("aria-describedby", box.id);
  } else for (const name of ["aria-invalid", "aria-describedby"]) input.removeAttribute(name);
}

export function labelled(label: string, input: HTMLElement, after?: HTMLElement | string, hint?: string): HTMLElement {
  input.id ||= newId();
  return h("div", { class: "vlm-row", title: hint }, h("label", { for: input.id }, label), input, after ?? null);
}

/** A number that is typed, or changed by the arrow keys (Shift: ten times as much). */
export function numberField(label: string, unit: string, changed: (value: number) => void, hint?: string): Field<number | null> & { unit: HTMLElement } {
  let value: number | null = null;
  const step = (event: KeyboardEvent) => {
    const way = ARROWS[event.key]?.[1];
    if (!way) return;
    event.preventDefault();
    const by = (event.shiftKey ? way : 0.1 * way) * 10 ** Math.floor(Math.log10(Math.abs(value ?? 0) || 1));
    value = Number(((value ?? 0) + by).toPrecision(6));
    input.value = typed(value);
    changed(value);
  };
  const read = () => {
    const number = Number(input.value.replace(",", ".").replace("−", "-"));
    const wrong = input.value.trim() === "" || !Number.isFinite(number);
    complain(input, wrong ? `a number is expected, not “${input.value.trim()}”` : "");
    if (!wrong) changed((value = number));
  };
  const input = h("input", { type: "text", inputmode: "decimal", class: "vlm-number", spellcheck: "false", onkeydown: step, onchange: read });
  const after = h("span", { class: "vlm-unit" }, unit);
  return {
    element: labelled(label, input, after, hint),
    unit: after,
    update(next) {
      value = next;
      if (input.matches(":focus")) return;
      input.value = next === null ? "" : typed(next);
    },
  };
}

/** A slider of the browser, with its value in words beside it. */
export function slider(label: string, [min, max, step]: [number, number, number], words: (value: number) => string, changed: Changed<number>, hint?: string): Field<number> {
  let held = false;
  const show = (value: number) => {
    told.textContent = words(value);
    input.setAttribute("aria-valuetext", words(value));
  };
  const move = (moving: boolean) => {
    held = moving;
    show(Number(input.value));
    changed(Number(input.value), moving);
  };
  const input = h("input", { type: "range", min, max, step, oninput: () => move(true), onchange: () => move(false) });
  const told = h("output", { class: "vlm-told" });
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
  const input = h("input", { type: "text", spellcheck: "false", autocomplete: "off", placeholder, onchange: () => changed(input.value.trim()) });
  return { element: labelled(label, input, undefined, hint), update: (value) => input.matches(":focus") || (input.value = value) };
}

/** One of a list, which may change; what is in no list is shown all the same. */
export function choice(label: string, options: () => string[], changed: (value: string) => void, hint?: string): Field<string> {
  const input = h("select", { onchange: () => changed(input.value) });
  let known = "";
  return {
    element: labelled(label, input, undefined, hint),
    update(value) {
      const list = [...new Set([...options(), value])];
      if (list.join() !== known) input.replaceChildren(...list.map((name) => h("option", { value: name }, name)));
      known = list.join();
      input.value = value;
    },
  };
}

export function toggle(label: string, changed: (on: boolean) => void, hint?: string): Field<boolean> {
  const input = h("input", { type: "checkbox", onchange: () => changed(input.checked) });
  return { element: h("label", { class: "vlm-toggle", title: hint }, input, h("span", {}, label)), update: (on) => void (input.checked = on) };
}

type Read<S, T> = (state: S) => T | undefined;

/** Makes the fields of a panel, each with what it shows of the panel's state; undefined hides it. */
export class Form<S> {
  private shows: ((state: S) => void)[] = [];

  add<T>(field: Field<T>, read: Read<S, T>): HTMLElement {
    this.shows.push((state) => {
      const value = read(state);
      field.element.hidden = value === undefined;
      if (value !== undefined) field.update(value);
    });
    return field.element;
  }

  number = (read: Read<S, number | null>, ...how: Parameters<typeof numberField>) => this.add(numberField(...how), read);
  slider = (read: Read<S, number>, ...how: Parameters<typeof slider>) => this.add(slider(...how), read);
  text = (read: Read<S, string>, ...how: Parameters<typeof textField>) => this.add(textField(...how), read);
  choice = (read: Read<S, string>, ...how: Parameters<typeof choice>) => this.add(choice(...how), read);
  toggle = (read: Read<S, boolean>, ...how: Parameters<typeof toggle>) => this.add(toggle(...how), read);

  update(state: S): void {
    for (const show of this.shows) show(state);
  }
}
