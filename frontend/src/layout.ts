// Where everything is: the bar above, the picture with what lies on it, the panels beside it.

import { otherType, type View } from "./camera";
import { helpDialog, historyMenu, saveDialog } from "./dialogs";
import { keyTable } from "./keys";
import { modes } from "./modes";
import { panesOf } from "./panes";
import { clipPanel } from "./panels/clip";
import { measurePanel } from "./panels/measure";
import { mediaPanel } from "./panels/media";
import { probePanel } from "./panels/probe";
import { scenePanel } from "./panels/scene";
import { slicePanel } from "./panels/slice";
import { timeBar } from "./panels/time";
import { tonePanel } from "./panels/tone";
import { viewsPanel } from "./panels/views";
import type { Panel, Parts } from "./parts";
import { ARROWS, button, h, newId } from "./ui/dom";
import { gridName, pretty } from "./ui/format";
import { unitChoice } from "./ui/units";
import type { FrameHead } from "./wire";

export function build(parts: Parts, legend: HTMLElement, link: { trouble: HTMLElement; form: HTMLElement }) {
  const { stage, store, server, notices, overlay, highlight, navigation } = parts;
  const badge = h("div", { class: "vlm-badge" }, "waiting for the first picture");
  const time = timeBar(server);
  const corner = h("div", { class: "vlm-corner" }, overlay.gizmo);
  const units = unitChoice(server, () => (stage.redraw(), mode.update(), panes.update(), tabs.current().update()));
  const lower = h("div", { class: "vlm-lower" }, legend, h("div", { class: "vlm-scale" }, overlay.bar, units.element));
  const mode = modes(parts);
  const panes = panesOf(parts, (point) => void (measure.takesPoint(point) || probe.through(point)));
  const stageBox = h(
    "div",
    { class: "vlm-stage", role: "region", "aria-label": "picture" },
    stage.canvas, highlight.element, overlay.lines, h("div", { class: "vlm-upper" }, badge, link.trouble, mode.element), corner, lower, time.element, notices.element, link.form,
  );

  const clip = clipPanel(parts);
  const views = viewsPanel(parts);
  const scene = scenePanel(parts);
  const ray = probePanel(parts, () => tabs.show("probe"), (point) => panes.state().shown && panes.go(point, true));
  const measure = measurePanel(parts, () => tabs.show("measure"));
  const probe = { ...ray, at: async (place: [number, number]) => void (measure.takes(place) || (await ray.at(place))) };
  const panels: [string, string, Panel][] = [
    ["media", "Media", mediaPanel(parts)],
    ["tone", "Tone", tonePanel(parts)],
    ["probe", "Ray", ray],
    ["measure", "Measure", measure],
    ["slice", "Slices", slicePanel(parts, panes)],
    ["clip", "Clip", clip],
    ["views", "Views", views],
    ["scene", "Scene", scene],
  ];
  const tabs = tabList(panels);

  const name = h("h1", {}, "voluminous");
  const facts = h("span", { class: "vlm-facts" });
  const angles = h("span", { class: "vlm-angles", title: "inclination, azimuth and position angle of the camera" });
  const save = saveDialog(parts, measure.marks);
  const keys = keyTable(parts, {
    views, time, probe, measure, panes, clip,
    save: save.open,
    help: () => help.open(),
    togglePanels: () => root.classList.toggle("vlm-bare"),
  });
  const help = helpDialog(keys);
  const history = historyMenu(store);
  const four = button("", "Three slices beside the picture, or the picture alone  (q)", panes.toggle, "four");
  const type = button("", "Parallel rays or perspective  (o)", () => navigation.change(otherType), "cube");
  const freely = button("", "Turntable or trackball  (t)", () => navigation.switchFreely(), "ball");
  const bar = h(
    "header",
    { class: "vlm-bar" },
    h("span", { class: "vlm-mark", "aria-hidden": "true" }),
    h("div", { class: "vlm-name" }, name, facts),
    angles,
    h("div", { class: "vlm-group" }, history.element),
    h(
      "div",
      { class: "vlm-group" },
      button("", "Back to the first view  (r)", () => navigation.reset(), "home"),
      button("", "Fit the whole volume  (f)", () => navigation.fit(), "fit"),
      type, freely, four,
    ),
    h(
      "div",
      { class: "vlm-group" },
      button("Save", "Save a picture or the scene  (s)", () => save.open(), "save"),
      button("", "Keys and gestures  (?)", () => help.open(), "help"),
    ),
  );
  const root = h(
    "div",
    // JupyterLab's own keys (a, b, x …) must not edit the notebook from here.
    { class: "vlm", "data-lm-suppress-shortcuts": "true" },
    h("div", { class: "vlm-frame" }, bar, panes.around(stageBox), tabs.element),
    help.element, save.element, notices.live,
  );

  let announced = "";
  return {
    root, keys, probe, stage: stageBox,
    opening(what: string) {
      badge.textContent = `opening ${what} …`;
    },
    welcomed() {
      time.update();
      this.described();
    },
    /** The volume is another one, or better known. */
    described() {
      const info = server.info!;
      name.textContent = info.name || "voluminous";
      facts.textContent = [info.shape?.length ? info.shape.join(" × ") : `${pretty(info.cells)} cells`, gridName(info.grid)].filter(Boolean).join(" · ");
      name.title = (server.welcome!.notes ?? []).join("\n");
      units.update();
      for (const [, , panel] of panels) panel.update();
      this.update();
      tabs.current().shown?.();
    },
    update() {
      history.update();
      mode.update();
      panes.update();
      four.setAttribute("aria-pressed", String(Boolean(panes.state().shown)));
      tabs.current().update();
      measure.update();
    },
    badge(head: FrameHead, newest: boolean) {
      const { words, state } = badgeOf(head, newest);
      badge.textContent = words;
      badge.dataset.state = state;
      badge.title = `drawn in ${pretty(head.ms)} ms, ${head.width} × ${head.height} pixels${head.how ? "; values of cells on the rays through the middles of pixels, to 11 binary digits" : ""}`;
      if (newest && head.exact && announced !== words) notices.announce(words);
      announced = words;
    },
    /** A frame has come. */
    framed(head: FrameHead) {
      this.camera(stage.view);
      if (head.exact) measure.rests();
    },
    camera(view: View | null) {
      if (!view) return;
      const degrees = (v: number) => `${(Math.round(v * 10) / 10).toFixed(1).replace("-", "−")}°`;
      angles.textContent = `incl ${degrees(view.incl)}  phi ${degrees(view.phi)}${view.posang ? `  posang ${degrees(view.posang)}` : ""}`;
      type.setAttribute("aria-pressed", String(view.type === "perspective"));
      freely.setAttribute("aria-pressed", String(navigation.freely));
      if (tabs.current() === scene) scene.update();
    },
  };
}

export function badgeOf(head: FrameHead, newest: boolean): { words: string; state: string } {
  if (!newest) return { words: "drawing …", state: "preview" };
  const error = head.error === null ? "" : `, error ≤ ${pretty(100 * head.error, 2)} %`;
  // How far the means of a coarser level are from all cells is not known.
  const cells = head.every > 1 ? `every ${head.every}${["nd", "rd"][head.every - 2] ?? "th"} cell` : "";
  if (head.exact && (cells || head.level > 0)) return { words: `${cells || `level ${head.level} of the file`}, error unknown`, state: "level" };
  if (head.exact) return { words: `exact${error}`, state: "exact" };
  const of = cells && ` of ${cells}`;
  if (head.scale < 1) {
    const named: Record<number, string> = { 2: "½", 3: "⅓", 4: "¼" };
    const inverse = Math.round(1 / head.scale);
    return { words: `${named[inverse] ?? `1/${inverse}`} preview${of}`, state: "preview" };
  }
  if (head.done > 0 && head.done < 1) {
    const level = head.level > 0 ? `level ${head.level}, ` : "";
    return { words: `${level}refining ${Math.round(100 * head.done)} %`, state: "refining" };
  }
  return { words: `preview${of}`, state: "preview" };
}

function tabList(panels: [string, string, Panel][]): { element: HTMLElement; current(): Panel; show(id: string): void } {
  let now = 0;
  const prefix = newId();
  const boxes = panels.map(([id, label, panel]) =>
    h("section", { class: "vlm-panel", id: prefix + id, role: "tabpanel", "aria-label": label, hidden: true }, panel.element),
  );
  const tabs = panels.map(([id, label], i) =>
    h("button", { type: "button", role: "tab", "aria-controls": prefix + id, onclick: () => show(i) }, label),
  );
  const list = h("div", { class: "vlm-tabs", role: "tablist", "aria-label": "Panels" }, ...tabs);
  list.addEventListener("keydown", (event) => {
    const by = ARROWS[event.key]?.[0];
    if (!by) return;
    event.preventDefault();
    show((now + by + tabs.length) % tabs.length);
    tabs[now].focus();
  });
  function show(i: number): void {
    now = i;
    tabs.forEach((tab, k) => {
      tab.setAttribute("aria-selected", String(k === i));
      tab.tabIndex = k === i ? 0 : -1;
      boxes[k].hidden = k !== i;
    });
    if (!ready) return;
    panels[i][2].update();
    panels[i][2].shown?.();
  }
  let ready = false;
  show(0);
  ready = true;
  return {
    element: h("aside", { class: "vlm-side" }, list, ...boxes),
    current: () => panels[now][2],
    show: (id) => {
      const i = panels.findIndex(([name]) => name === id);
      if (i !== now) show(i);
    },
  };
}
