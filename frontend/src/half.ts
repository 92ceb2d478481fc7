// Exact frames: float16 numbers, each row as differences, low bytes and high bytes apart, deflated.
// Undoing that gives the bits that WebGL takes as HALF_FLOAT; no number is converted on the way.

export async function inflate(bytes: Uint8Array): Promise<Uint8Array> {
  const stream = new Blob([bytes as BlobPart]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Undo the differences and the split into bytes; planes of one channel after the other. */
export function undifference(bytes: Uint8Array, width: number, height: number, channels: number): Uint16Array {
  const count = width * height * channels;
  if (bytes.length !== 2 * count) throw new Error(`expected ${2 * count} bytes, got ${bytes.length}`);
  const out = new Uint16Array(count);
  for (let row = 0, i = 0; row < height * channels; row++) {
    let value = 0;
    for (let x = 0; x < width; x++, i++) {
      value = (value + bytes[i] + 256 * bytes[count + i]) & 0xffff;
      out[i] = value;
    }
  }
  return out;
}

/** The number that 16 bits mean. */
export function fromHalf(bits: number): number {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

/** Smallest, smallest positive and largest number of a plane. Positive halves are ordered as their bits. */
export function limitsOf(halves: Uint16Array): [number, number, number] {
  let [most, least, faintest, lowest, nearest] = [0, 0xffff, 0x7fff, 0, 0xffff];
  for (const bits of halves) {
    // -∞ stands for pixels without a value.
    if (bits === 0xfc00) continue;
    if (bits & 0x8000) {
      lowest = Math.max(lowest, bits);
      nearest = Math.min(nearest, bits);
    } else {
      if (bits > most) most = bits;
      if (bits < least) least = bits;
      if (bits && bits < faintest) faintest = bits;
    }
  }
  const smallest = lowest > 0x8000 || least === 0xffff ? lowest : least;
  return [fromHalf(smallest), fromHalf(faintest), least < 0xffff ? fromHalf(most) : nearest < 0xffff ? fromHalf(nearest) : 0];
}

/** Previews: the intensity that a grey value of a JPEG means, -∞ where there is none. */
export function fromCode(value: number, { low, high, codec }: { low: number; high: number; codec: string }): number {
  if (codec === "linear-jpeg") return value === 0 ? -Infinity : low + ((high - low) * (value - 1)) / 254;
  return value === 0 ? 0 : 2 ** (low + ((high - low) * (value - 1)) / 254);
}
