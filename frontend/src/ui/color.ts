// Colours as the document has them (numbers, names, #rrggbb) and as the page shows them.

export type Rgb = [number, number, number];

/** Twelve that are told apart with any kind of colour vision; offered first. */
export const SAFE = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7", "#ffffff"];

/** Numbers from 0 to 1 (or above) of a colour; white for what the page cannot read. */
export function colorOf(color: any): Rgb {
  if (Array.isArray(color)) {
    if (color.length === 1) return [color[0], color[0], color[0]];
    return [Number(color[0]) || 0, Number(color[1]) || 0, Number(color[2]) || 0];
  }
  if (typeof color === "number") return [color, color, color];
  if (typeof color !== "string") return [1, 1, 1];
  let hex = color;
  if (!/^#[0-9a-f]{6}$/i.test(hex)) {
    if (typeof document === "undefined") return [1, 1, 1];
    const context = document.createElement("canvas").getContext("2d");
    if (!context) return [1, 1, 1];
    context.fillStyle = "#ffffff";
    context.fillStyle = color;
    hex = String(context.fillStyle);
  }
  return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255) as Rgb;
}

/** As #rrggbb. */
export function toHex(rgb: Rgb): string {
  const two = (v: number) => Math.round(255 * Math.min(Math.max(v, 0), 1)).toString(16).padStart(2, "0");
  return "#" + rgb.map(two).join("");
}

/** A colour of full brightness, since emission is often far below or above one. */
export function vivid(color: any): string {
  const rgb = colorOf(color);
  const most = Math.max(...rgb);
  return toHex(most > 0 ? (rgb.map((v) => v / most) as Rgb) : [0.5, 0.5, 0.5]);
}

/** Colours side by side, as a background of CSS. */
export function stripes(colors: any[]): string {
  const few = colors.slice(0, 4).map((color) => toHex(colorOf(color)));
  return `linear-gradient(90deg, ${few.map((color, k) => `${color} ${(100 * k) / few.length}% ${(100 * (k + 1)) / few.length}%`).join(",")})`;
}

/** A colormap as a background of CSS. */
export function gradient(table: Uint8Array | undefined): string {
  if (!table) return "linear-gradient(90deg, #222, #eee)";
  const stops = [...Array(13).keys()].map((k) => {
    const i = 3 * Math.round((k / 12) * 255);
    return `rgb(${table[i]},${table[i + 1]},${table[i + 2]})`;
  });
  return `linear-gradient(90deg, ${stops.join(",")})`;
}
