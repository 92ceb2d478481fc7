// From intensities to colours. All of it happens in the browser: nothing is sent while a slider
// moves, and it works while the server is busy or gone. The document learns of it at the end.

import type { Panel, Parts } from "../parts";
import type { Patch } from "../store";
import { bend, STRETCHES, type Tone } from "../tone";
import { colorOf, toHex } from "../ui/color";
import { button, h, refill, svg } from "../ui/dom";
import { Form } from "../ui/fields";
import { numberOf, pretty } from "../ui/format";
import type { Table } from "../wire";

const STOPS = 10;
const PLOT = 100;
const DEFAULT_MIX: Record<number, string[]> = { 1: ["#ffffff"], 2: ["#ff9933", "#1a66ff"], 3: ["#ff0000", "#00ff00", "#0000ff"] };

export function tonePanel({ store, stage }: Pick<Parts, "store" | "stage">): Panel {
  const form = new Form<Table>();
  const image = (): Table => store.document.image ?? {};
  const automatic = () => stage.head?.exposure ?? 1;
  const exposure = ({ exposure, vmax }: Table): number => numberOf(exposure) ?? (vmax ? 1 / Number(vmax) : automatic());
  // With a colormap a window of values is shown: parts of all that there are.
  const span = (): [number, number] => {
    const [least, , most] = stage.limits[0] ?? [0, 0, 1];
    return [least, most > least ? most - least : 1];
  };
  const ends = () => [stage.tone?.black ?? 0, stage.tone?.white ?? 1];
  const window_ = (low: number, high: number, moving = false) => {
    const patch: Patch = [["image.vmin", Number(low.toPrecision(5))], ["image.vmax", Number(high.toPrecision(5))], ["image.exposure", null]];
    if (!(high > low)) return;
    if (moving) store.show(patch);
    else store.set(patch, "window");
  };
  const width = (now: Table) => (now.colormap ? Math.log2(Math.max((ends()[1] - ends()[0]) / span()[1], 1e-4)) : undefined);
  const level = (now: Table) => (now.colormap ? ((ends()[0] + ends()[1]) / 2 - span()[0]) / span()[1] : undefined);
  const stretch = (now: Table) => now.stretch ?? "linear";
  const power = (now: Table): number | undefined => (typeof now.stretch === "number" ? now.stretch : undefined);
  const softness = (now: Table) => ({ asinh: Math.log10(now.softening ?? 0.1), log: Math.log10(now.softening ?? 0.01) })[stretch(now) as string];
  const channels = () => [...(image().colormap ? [] : ["all"]), ...Array.from({ length: store.channels }, (_, k) => String(k + 1))];
  const channel = (now: Table) => (store.channels < 2 ? undefined : now.channels == null ? "all" : String(Number([now.channels].flat()[0]) + 1));
  const set = (name: string, value: any, label: string, moving = false) => {
    const patch: Patch = [[`image.${name}`, value]];
    if (name === "exposure") patch.push(["image.vmax", null]);
    if (moving) store.show(patch);
    else store.set(patch, label);
  };
  const setMap = (choice: string) => {
    const name = choice === "none" ? null : choice;
    store.set([["image.colormap", name], ["image.mix", null], ["image.channels", name && (image().channels ?? (store.channels > 1 ? 0 : null))]], "colormap");
  };

  const mix = h("div", { class: "vlm-mix" });
  const curve = svg("path", { class: "vlm-curve" });
  const plot = svg(
    "svg",
    { class: "vlm-tone-plot", viewBox: `0 0 ${PLOT} ${PLOT / 2}`, preserveAspectRatio: "none", "aria-hidden": "true" },
    svg("path", { class: "vlm-diagonal", d: `M0 ${PLOT / 2}L${PLOT} 0` }), curve,
  );

  let mixed = "";
  let drawn = "";
  function drawMix(): void {
    const given = image().mix;
    const n = [image().channels ?? [...Array(store.channels).keys()]].flat().length;
    const colors: string[] = Array.isArray(given) ? given.map((c: any) => toHex(colorOf(c))) : DEFAULT_MIX[n] ?? Array(n).fill("#ffffff");
    const key = JSON.stringify(colors);
    if (key === mixed || mix.querySelector(":focus")) return;
    mixed = key;
    const put = (moving: boolean) => set("mix", inputs.map((input) => colorOf(input.value).map((v) => Number(v.toFixed(4)))), "mix", moving);
    const inputs = colors.map((value, i) =>
      h("input", { type: "color", class: "vlm-color", value, "aria-label": `colour of channel ${i + 1}`, oninput: () => put(true), onchange: () => put(false) }),
    );
    refill(mix, h("span", { class: "vlm-label" }, "Channels as"), ...inputs, given && button("×", "The usual colours", () => set("mix", null, "mix")));
  }

  function drawCurve(tone: Tone): void {
    const points = [...Array(51).keys()].map((k) => `${(2 * k * PLOT) / 100} ${((1 - bend(k / 50, tone)) * (PLOT / 2)).toFixed(2)}`);
    const line = `M${points.join("L")}`;
    if (line !== drawn) curve.setAttribute("d", line);
    drawn = line;
  }

  const element = h(
    "div", {},
    form.slider(
      (now) => (now.colormap ? undefined : Math.log2(exposure(now) / automatic())), "Exposure", [-STOPS, STOPS, 0.05], (v) => `${v > 0 ? "+" : ""}${pretty(v, 3)} stops`,
      (v, moving) => set("exposure", Number((automatic() * 2 ** v).toPrecision(6)), "exposure", moving), "Against the automatic exposure; each stop is a factor of two",
    ),
    form.slider(
      width, "Window", [-10, 1, 0.02], (v) => pretty(span()[1] * 2 ** v),
      (v, moving) => window_((ends()[0] + ends()[1] - span()[1] * 2 ** v) / 2, (ends()[0] + ends()[1] + span()[1] * 2 ** v) / 2, moving), "From the first to the last colour",
    ),
    form.slider(
      level, "Level", [-0.1, 1.1, 0.002], (v) => pretty(span()[0] + span()[1] * v),
      (v, moving) => {
        const [middle, half] = [span()[0] + span()[1] * v, (ends()[1] - ends()[0]) / 2];
        window_(middle - half, middle + half, moving);
      },
      "The value in the middle of the window",
    ),
    h(
      "div", { class: "vlm-actions" },
      button("Automatic", "The exposure that shows 99.9 % of the pixels below white  (n)", () => store.set([["image.exposure", null], ["image.vmax", null], ...(image().colormap ? [["image.vmin", null] as [string, null]] : [])], "automatic exposure")),
      button("Reset", "No choices: as Image.to_rgb shows it", () => store.set([["image", {}]], "reset tone")),
    ),
    form.number((now) => Number((now.colormap ? ends()[1] : 1 / exposure(now)).toPrecision(4)), "White at", "", (v) => (image().colormap ? window_(ends()[0], v) : v > 0 && set("exposure", 1 / v, "exposure")), "The intensity that is shown as white"),
    form.number((now) => Number((now.colormap ? ends()[0] : numberOf(now.vmin) ?? 0).toPrecision(4)), "Black at", "", (v) => set("vmin", v || null, "black"), "The intensity that is shown as black"),
    h("h2", {}, "Curve"), plot,
    form.choice((now) => (power(now) ? "custom" : stretch(now)), "Stretch", () => [...STRETCHES, "custom"], (name) => set("stretch", { linear: null, custom: 2.2 }[name] ?? name, "stretch")),
    form.slider(power, "Gamma", [0.5, 5, 0.05], pretty, (v, moving) => set("stretch", v, "gamma", moving)),
    form.slider(softness, "Linear below", [-4, 0, 0.05], (v) => `${pretty(10 ** v, 2)} of white`, (v, moving) => set("softening", Number((10 ** v).toPrecision(3)), "softening", moving)),
    form.choice(
      (now) => (now.colormap ? undefined : now.gamut ?? "hue"), "Too bright", () => ["hue", "clip"],
      (name) => set("gamut", name === "hue" ? null : name, "gamut"), "hue: keeps its hue; clip: turns white",
    ),
    h("h2", {}, "Colours"),
    form.choice((now) => now.colormap ?? "none", "Colormap", () => ["none", ...[...stage.tables.keys()].sort()], setMap, "Shows one channel through a colormap"),
    form.choice(channel, "Channel", channels, (name) => set("channels", name === "all" ? null : Number(name) - 1, "channel")),
    form.toggle((now) => (now.colormap ? now.norm === "log" : undefined), "logarithm of the values", (on) => store.set([["image.norm", on ? "log" : null], ["image.stretch", null]], "scale")),
    mix,
    h("p", { class: "vlm-hint" }, "Made in the browser from intensities: costs no rendering, and the numbers stay."),
  );
  return {
    element,
    update() {
      form.update(image());
      mix.hidden = Boolean(image().colormap);
      drawMix();
      if (stage.tone) drawCurve(stage.tone);
    },
  };
}
