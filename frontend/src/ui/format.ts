// Numbers as people read and type them.

const RAISED: Record<string, string> = {
  "-": "⁻", "0": "⁰", "1": "¹", "2": "²", "3": "³", "4": "⁴", "5": "⁵", "6": "⁶", "7": "⁷", "8": "⁸", "9": "⁹",
};

export function raised(n: number): string {
  return [...String(n)].map((c) => RAISED[c]).join("");
}

/** As in print: 0.0123, 4500, 3.2×10⁻²⁰. */
export function pretty(value: number | null | undefined, digits = 3): string {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e5 || size < 1e-3)) {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    const plain = String(Number(mantissa));
    const power = `10${raised(Number(exponent))}`;
    const sign = value < 0 ? "−" : "";
    return sign + (Math.abs(Number(plain)) === 1 ? power : `${plain.replace("-", "")}×${power}`);
  }
  return String(Number(value.toPrecision(digits))).replace(/^-/, "−");
}

/** As in a field that can be typed into. */
export function typed(value: number, digits = 5): string {
  return String(Number(Number(value).toPrecision(digits)));
}

/** A duration that is roughly known. */
export function duration(seconds: number): string {
  if (seconds < 1) return "a second";
  return seconds < 100 ? `${pretty(seconds, seconds < 10 ? 1 : 2)} s` : seconds < 6000 ? `${Math.round(seconds / 60)} min` : `${pretty(seconds / 3600, 2)} h`;
}

export const fileSize = (bytes: number): string => (bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : bytes < 1e9 ? `${pretty(bytes / 1e6, 2)} MB` : `${pretty(bytes / 1e9, 2)} GB`);

/** A kind of grid in plain words: "RefinedSphericalGrid" is refined spherical. */
export function gridName(type: string): string {
  const words = type.replace(/Grid$/, "").split(/(?=[A-Z])/).map((word) => word.toLowerCase()).join(" ");
  return { cartesian: "Cartesian", patch: "patches" }[words] ?? words;
}

/** Units as in print: "g / cm3" is g cm⁻³. */
export function prettyUnit(unit: string | null | undefined): string {
  if (!unit || unit === "1") return "";
  const inside = /^(\w+)\((.*)\)$/.exec(unit);
  if (inside) return `${inside[1]}(${prettyUnit(inside[2])})`;
  let below = false;
  return unit
    .split(/[\s*]+|(\/)/)
    .filter((part) => part && part !== "1")
    .map((part) => {
      if (part === "/") {
        below = true;
        return "";
      }
      const [, name, power] = /^(.*?)\^?\(?(-?\d*)\)?$/.exec(part)!;
      const exponent = (power ? Number(power) : 1) * (below ? -1 : 1);
      below = false;
      return (OTHER[name] ?? name) + (exponent === 1 ? "" : raised(exponent));
    })
    .filter(Boolean)
    .join(" ");
}

export function withUnit(value: number, unit: string | null | undefined, digits = 3): string {
  const told = prettyUnit(unit);
  return told ? `${pretty(value, digits)} ${told}` : pretty(value, digits);
}

/** The number of a quantity: 3, or "3 pc". */
export function numberOf(quantity: any): number | null {
  if (typeof quantity === "number") return quantity;
  if (typeof quantity !== "string") return null;
  const number = parseFloat(quantity);
  return Number.isFinite(number) ? number : null;
}

/** The unit of a quantity: of "3 pc" it is pc. */
export function unitOf(quantity: any): string {
  return typeof quantity === "string" ? quantity.replace(/^\s*[-+]?[\d.]+(e[-+]?\d+)?\s*/i, "") : "";
}

/** Another number in the unit of an old quantity. */
export function likewise(old: any, value: number): number | string {
  const unit = unitOf(old);
  return unit ? `${value} ${unit}` : value;
}

/** Round numbers between two ends, about `count` of them. */
export function ticks(low: number, high: number, count: number): number[] {
  const step = roundNumber((high - low) / Math.max(count, 1));
  const found: number[] = [];
  if (!(step > 0)) return found;
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(Number((i * step).toPrecision(12)));
  return found;
}

/** The nearest of 1, 2, 5 times a power of ten above a number. */
export function roundNumber(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  const first = value / power;
  return (first <= 1.001 ? 1 : first <= 2.001 ? 2 : first <= 5.001 ? 5 : 10) * power;
}

// In centimetres; what is asked for is a length that reads well, not a conversion of a result.
const LENGTHS: [string, number][] = [
  ["Å", 1e-8], ["nm", 1e-7], ["µm", 1e-4], ["mm", 0.1], ["cm", 1], ["m", 100], ["km", 1e5], ["R☉", 6.957e10], ["au", 1.495978707e13],
  ["pc", 3.0856775814913674e18], ["kpc", 3.0856775814913674e21], ["Mpc", 3.0856775814913674e24],
  ["Gpc", 3.0856775814913674e27],
];
const OTHER: Record<string, string> = { AU: "au", um: "µm", micron: "µm", Angstrom: "Å", R_sun: "R☉", solRad: "R☉" };

/** Units of everyday lengths; those above are of astronomy. */
const EARTHLY = 7;
/** Above so many centimetres a length is one of astronomy. */
const FAR = 1e10;
/** Least size, in centimetres, of a volume whose lengths are shown in a unit: as its field has them, mm for heads. */
const FROM: Record<string, number> = { nm: 1e-6, µm: 2e-5, mm: 0.2, cm: 100, m: 1e4, km: 1e6, au: 7e11, pc: 1.5e17, kpc: 1.5e21, Mpc: 1.5e24, Gpc: 1.5e27 };
/** The unit in which lengths of volumes in another unit are shown: one on a page. */
const SHOWN = new Map<string, string>();

const sizeOf = (unit: string): [string, number] | undefined => LENGTHS.find(([name]) => name === (OTHER[unit] ?? unit));

/** A length (a number, or a text with a unit) in a unit; null if one of the units is none that is known here. */
export function lengthIn(quantity: any, unit: string): number | null {
  const number = numberOf(quantity);
  const own = unitOf(quantity);
  if (number === null || own === "" || own === unit) return number;
  const [from, to] = [sizeOf(own), sizeOf(unit)];
  return from && to ? (number * from[1]) / to[1] : null;
}

/** A round length not above `most`, with the unit that suits it. */
export function roundLength(most: number, unit: string): { length: number; text: string } {
  const down = (value: number) => {
    const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
    const first = value / power;
    return (first >= 5 ? 5 : first >= 2 ? 2 : 1) * power;
  };
  const own = sizeOf(unit);
  if (!own) return { length: down(most), text: withUnit(down(most), unit) };
  const [name, size] = unitFor(most * own[1], unit, own[1]);
  const value = down((most * own[1]) / size);
  return { length: (value * size) / own[1], text: `${pretty(value)} ${name}` };
}

/** The unit for a length in centimetres: that of the page, else of its kind the largest of which it is a hundredth. */
function unitFor(length: number, unit: string, own: number): [string, number] {
  const family = familyOf(length, own);
  return sizeOf(SHOWN.get(unit) ?? "") ?? [...family].reverse().find(([, size]) => length >= 0.01 * size) ?? family[0];
}

const familyOf = (length: number, own: number) => (own >= 6e10 || length > FAR ? LENGTHS.slice(EARTHLY) : LENGTHS.slice(0, EARTHLY));

/** Units in which lengths of a volume can be shown, and the one that its field uses for a volume of this size. */
export function unitsFor(extent: number, unit: string): { names: string[]; usual: string } {
  const own = sizeOf(unit);
  if (!own || !(extent > 0)) return { names: [], usual: "" };
  const [length, family] = [extent * own[1], familyOf(extent * own[1], own[1])];
  const fits = ([name]: [string, number]) => length >= (FROM[name] ?? 0);
  return { names: family.map(([name]) => name), usual: ([...family].reverse().find(fits) ?? family[0])[0] };
}

/** Show lengths of volumes in a unit in another one, everywhere on the page. */
export function showLengthsIn(unit: string, name: string): void {
  SHOWN.set(unit, name);
}

export const lengthsShownIn = (unit: string): string => SHOWN.get(unit) ?? "";

/** What takes numbers per length of a volume to those per length as the page shows it, and that unit. */
export function perLength(unit: string): [factor: number, unit: string] {
  const name = lengthsShownIn(unit) || unit;
  return [lengthIn(`1 ${name}`, unit) ?? 1, unit && prettyUnit(`1 / ${name}`)];
}

/** A length in the unit that suits it: the number, and the unit. */
export function suited(length: number, unit: string): [number, string] {
  const own = sizeOf(unit);
  if (!own || !length) return [length, (own && SHOWN.get(unit)) || unit];
  const [name, size] = unitFor(Math.abs(length) * own[1], unit, own[1]);
  return [(length * own[1]) / size, name];
}

/** A point, in the unit that suits its largest coordinate. */
export function prettyPoint(point: number[], unit: string): string {
  const most = Math.max(...point.map(Math.abs));
  const [value, name] = suited(most, unit);
  return `${point.map((v) => pretty(most ? (v * value) / most : 0)).join(", ")} ${prettyUnit(name)}`.trim();
}

export const prettyLength = (length: number, unit: string): string => withUnit(...suited(length, unit));
