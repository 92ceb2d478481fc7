// From intensities to colours. All of it happens in the browser: nothing is sent while a slider
// moves, and it works while the server is busy or gone. The document learns of it at the end.

import type { App } from "../app";
import type { Panel } from "../layout";
import { bend, STRETCHES, type Tone } from "../tone";
import { colorOf, toHex } from "../ui/color";
import { button, h, refill, svg } from "../ui/dom";
import { choice, numberField, slider, toggle } from "../ui/fields";
import { numberOf, pretty } from "../ui/format";

const STOPS = 10;
const PLOT = 100;
const DEFAULT_MIX: Record<number, string[]> = { 1: ["#ffffff"], 2: ["#ff9933", "#1a66ff"] };

export function tonePanel(app: App): Panel {
  const { store, stage } = app;
  const image = () => store.document.image ?? {};
  const automatic = () => stage.head?.exposure ?? 1;
  const set = (name: string, value: any, label: string, moving = false) => {
    const patch: [string, any][] = [[`image.${name}`, value]];
    if (name === "exposure") patch.push(["image.vmax", null]);
    if (moving) store.show(patch);
    else store.set(patch, label);
  };

  const exposure = slider(
    "Exposure",
    [-STOPS, STOPS, 0.05],
    (v) => `${v > 0 ? "+" : ""}${pretty(v, 3)} stops`,
    (v, moving) => set("exposure", Number((automatic() * 2 ** v).toPrecision(6)), "exposure", moving),
    "Against the automatic exposure; each stop is a factor of two",
  );
  const white = numberField("White at", "", (value) => value > 0 && set("exposure", 1 / value, "exposure"), "The intensity that is shown as white");
  const black = numberField("Black at", "", (value) => set("vmin", value === 0 ? null : value, "black"), "The intensity that is shown as black");
  const stretch = choice("Stretch", [...STRETCHES, "custom"], (name) => set("stretch", name === "linear" ? null : name === "custom" ? 2.2 : name, "stretch"));
  const gamma = slider("Gamma", [0.5, 5, 0.05], (v) => pretty(v), (v, moving) => set("stretch", v, "gamma", moving));
  const softening = slider("Linear below", [-4, 0, 0.05], (v) => `${pretty(10 ** v, 2)} of white`, (v, moving) => set("softening", Number((10 ** v).toPrecision(3)), "softening", moving));
  const gamut = choice("Too bright", ["hue", "clip"], (name) => set("gamut", name === "hue" ? null : name, "gamut"), "hue: keeps its hue; clip: turns white");
  const maps = choice("Colormap", ["none"], (name) => {
    const one = image().channels ?? (store.channels > 1 ? 0 : null);
    store.set([["image.colormap", name === "none" ? null : name], ["image.mix", null], ["image.channels", name === "none" ? null : one]], "colormap");
  }, "Shows one channel through a colormap");
  const channel = choice("Channel", [], (name) => set("channels", name === "all" ? null : Number(name) - 1, "channel"));
  const log = toggle("logarithm of the values", (on) => store.set([["image.norm", on ? "log" : null], ["image.stretch", null]], "scale"));
  const mix = h("div", { class: "vlm-mix" });
  const curve = svg("path", { class: "vlm-curve" });
  const plot = svg(
    "svg",
    { class: "vlm-tone-plot", viewBox: `0 0 ${PLOT} ${PLOT / 2}`, preserveAspectRatio: "none", "aria-hidden": "true" },
    svg("path", { class: "vlm-diagonal", d: `M0 ${PLOT / 2}L${PLOT} 0` }), curve,
  );
  const auto = button("Automatic", "The exposure that shows 99.9 % of the pixels below white  (n)", () => store.set([["image.exposure", null], ["image.vmax", null]], "automatic exposure"));
  const plain = button("Reset", "No choices: as Image.to_rgb shows it", () => store.set([["image", {}]], "reset tone"));

  let mixed = "";
  function drawMix(): void {
    const given = image().mix;
    const n = [image().channels ?? [...Array(store.channels).keys()]].flat().length;
    const names = n === 3 ? ["#ff0000", "#00ff00", "#0000ff"] : DEFAULT_MIX[n] ?? Array(n).fill("#ffffff");
    const colors: string[] = Array.isArray(given) ? given.map((c: any) => toHex(colorOf(c))) : names;
    const key = JSON.stringify(colors);
    if (key === mixed || mix.querySelector(":focus")) return;
    mixed = key;
    const inputs = colors.map((color, i) => h("input", { type: "color", class: "vlm-color", value: color, "aria-label": `color of channel ${i + 1}` }));
    const rows = () => inputs.map((input) => colorOf(input.value).map((v) => Number(v.toFixed(4))));
    for (const input of inputs) {
      input.addEventListener("input", () => set("mix", rows(), "mix", true));
      input.addEventListener("change", () => set("mix", rows(), "mix"));
    }
    refill(mix, h("span", { class: "vlm-label" }, "Channels as"), ...inputs, given && button("×", "The usual colours", () => set("mix", null, "mix")));
  }

  function drawCurve(tone: Tone): void {
    let path = "";
    for (let k = 0; k <= 50; k++) {
      const v = k / 50;
      path += `${k ? "L" : "M"}${(PLOT * v).toFixed(1)} ${((1 - bend(v, tone)) * (PLOT / 2)).toFixed(2)}`;
    }
    curve.setAttribute("d", path);
  }

  return {
    element: h(
      "div", {},
      exposure.element, h("div", { class: "vlm-actions" }, auto, plain), white.element, black.element,
      h("h3", {}, "Curve"), plot, stretch.element, gamma.element, softening.element, gamut.element,
      h("h3", {}, "Colours"), maps.element, channel.element, log.element, mix,
      h("p", { class: "vlm-hint" }, "Made in the browser from intensities: costs no rendering, and the numbers stay."),
    ),
    update() {
      const now = image();
      const given = numberOf(now.exposure);
      const shown = given ?? (now.vmax ? 1 / Number(now.vmax) : automatic());
      exposure.update(Math.log2(shown / automatic()));
      white.update(Number((1 / shown).toPrecision(4)));
      black.update(numberOf(now.vmin) ?? 0);
      const name = now.stretch ?? "linear";
      stretch.update(typeof name === "number" ? "custom" : name);
      gamma.element.hidden = typeof name !== "number";
      if (typeof name === "number") gamma.update(name);
      softening.element.hidden = name !== "asinh" && name !== "log";
      softening.update(Math.log10(now.softening ?? (name === "log" ? 0.01 : 0.1)));
      gamut.update(now.gamut ?? "hue");
      gamut.element.hidden = Boolean(now.colormap);
      maps.options(["none", ...[...stage.tables.keys()].sort()]);
      maps.update(now.colormap ?? "none");
      channel.options([...(now.colormap ? [] : ["all"]), ...[...Array(store.channels).keys()].map((k) => String(k + 1))]);
      channel.element.hidden = store.channels < 2;
      const one = [now.channels].flat()[0];
      channel.update(one === undefined || one === null ? "all" : String(Number(one) + 1));
      log.element.hidden = !now.colormap;
      log.update(now.norm === "log");
      mix.hidden = Boolean(now.colormap);
      drawMix();
      if (stage.tone) drawCurve(stage.tone);
    },
  };
}
