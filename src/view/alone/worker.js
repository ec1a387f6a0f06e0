// Unpacks the model, and sorts it by depth for each camera.

// --- gzip, where the browser does not have it ------------------------------------------------------------------------------

const EXTRA = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
const ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/** A prefix code by the lengths of its symbols: how many codes each length has, and the symbols in order. */
function code(lengths) {
  const counts = new Uint16Array(16), starts = new Uint16Array(16), symbols = new Uint16Array(lengths.length);
  for (const l of lengths) counts[l] += 1;
  counts[0] = 0;
  for (let l = 1; l < 16; l++) starts[l] = starts[l - 1] + counts[l - 1];
  lengths.forEach((l, s) => { if (l) symbols[starts[l]++] = s; });
  return { counts, symbols };
}

/** The content of a gzip file (RFC 1951, RFC 1952). */
function inflate(bytes) {
  let at = 10, bits = 0, held = 0, end = 0;
  if (bytes[3] & 4) at += 2 + bytes[at] + 256 * bytes[at + 1];
  for (const flag of [8, 16]) if (bytes[3] & flag) while (bytes[at++]);
  if (bytes[3] & 2) at += 2;
  const size = new DataView(bytes.buffer, bytes.byteOffset).getUint32(bytes.length - 4, true);
  const out = new Uint8Array(size);
  const take = (n) => {
    while (held < n) { bits |= bytes[at++] << held; held += 8; }
    const value = bits & ((1 << n) - 1);
    bits >>>= n;
    held -= n;
    return value;
  };
  const symbol = ({ counts, symbols }) => {
    let word = 0, first = 0, index = 0;
    for (let l = 1; l < 16; l++) {
      word |= take(1);
      const count = counts[l];
      if (word - first < count) return symbols[index + word - first];
      index += count;
      first = (first + count) << 1;
      word <<= 1;
    }
    throw new Error("the model's data are damaged");
  };
  const lengthBase = [], distanceBase = [];
  for (let k = 0, l = 3; k < 29; l += 1 << EXTRA[k++]) lengthBase.push(k === 28 ? 258 : l);
  for (let k = 0, d = 1; k < 30; k++) { distanceBase.push(d); d += 1 << Math.max(0, (k >> 1) - 1); }
  for (let last = 0; !last;) {
    last = take(1);
    const kind = take(2);
    if (kind === 0) {
      bits = held = 0;
      const length = bytes[at] + 256 * bytes[at + 1];
      out.set(bytes.subarray(at + 4, at + 4 + length), end);
      at += 4 + length;
      end += length;
      continue;
    }
    let literals, distances;
    if (kind === 1) {
      const fixed = Array.from({ length: 288 }, (_, s) => (s < 144 ? 8 : s < 256 ? 9 : s < 280 ? 7 : 8));
      [literals, distances] = [code(fixed), code(new Array(30).fill(5))];
    } else {
      const [n, m, k] = [257 + take(5), 1 + take(5), 4 + take(4)], first = new Array(19).fill(0), lengths = [];
      for (let i = 0; i < k; i++) first[ORDER[i]] = take(3);
      const meta = code(first);
      while (lengths.length < n + m) {
        const s = symbol(meta);
        if (s < 16) lengths.push(s);
        else {
          const value = s === 16 ? lengths[lengths.length - 1] : 0;
          for (let r = s === 16 ? 3 + take(2) : s === 17 ? 3 + take(3) : 11 + take(7); r > 0; r--) lengths.push(value);
        }
      }
      [literals, distances] = [code(lengths.slice(0, n)), code(lengths.slice(n))];
    }
    for (let s = symbol(literals); s !== 256; s = symbol(literals)) {
      if (s < 256) { out[end++] = s; continue; }
      const length = lengthBase[s - 257] + take(EXTRA[s - 257]);
      const d = symbol(distances), distance = distanceBase[d] + take(Math.max(0, (d >> 1) - 1));
      for (let i = 0; i < length; i++, end++) out[end] = out[end - distance];
    }
  }
  return out;
}

async function unzipped(bytes) {
  if (typeof DecompressionStream === "undefined") return inflate(bytes);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function decoded(text) {
  const raw = atob(text.trim()), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

// --- The model ---------------------------------------------------------------------------------------------------------------

let means = null; // n x 3, in the file's axes

/** At least `words` words, rounded up to whole rows of a texture: 2^`widthBits` texels of four words. */
function texture(words, widthBits) {
  const row = 4 * 2 ** widthBits;
  return new Uint32Array(Math.max(1, Math.ceil(words / row)) * row);
}

async function open({ model, widthBits, fallback }) {
  const packed = decoded(model), plain = fallback ? inflate(packed) : await unzipped(packed), view = new DataView(plain.buffer);
  const n = view.getUint32(8, true), [degree, fractional] = [plain[12], plain[13]];
  const rest = 3 * ((degree + 1) ** 2 - 1), texels = Math.ceil(rest / 16), unit = 2 ** -fractional;
  const [alphas, colours, scales, turns, sh] = [9, 10, 13, 16, 20].map((row) => 16 + n * row);
  const splats = texture(8 * n, widthBits), bands = texture(4 * texels * n, widthBits);
  const real = new Float32Array(splats.buffer), bytes = new Uint8Array(bands.buffer);
  means = new Float32Array(3 * n);
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < 3; k++) {
      const at = 16 + 9 * i + 3 * k;
      means[3 * i + k] = ((plain[at] | plain[at + 1] << 8 | plain[at + 2] << 16) << 8 >> 8) * unit;
      real[8 * i + k] = means[3 * i + k];
    }
    const [c, s] = [colours + 3 * i, scales + 3 * i];
    splats[8 * i + 3] = view.getUint32(turns + 4 * i, true);
    splats[8 * i + 4] = plain[c] | plain[c + 1] << 8 | plain[c + 2] << 16 | plain[alphas + i] << 24;
    splats[8 * i + 5] = plain[s] | plain[s + 1] << 8 | plain[s + 2] << 16;
    for (let k = 0; k < rest; k++) bytes[16 * texels * i + k] = plain[sh + rest * i + k];
  }
  postMessage({ n, degree, texels, splats, bands }, [splats.buffer, bands.buffer]);
}

// --- Sorting -----------------------------------------------------------------------------------------------------------------

let keys = null, order = null, other = null;
const counts = new Uint32Array(65536);

/** One pass of a radix sort by 16 bits, greatest first; of equal ones the last comes first, or keeps its place. */
function pass(from, to, n, shift, backwards) {
  counts.fill(0);
  for (let i = 0; i < n; i++) counts[keys[from[i]] >>> shift & 65535]++;
  for (let k = 65535, sum = 0; k >= 0; k--) {
    const count = counts[k];
    counts[k] = sum;
    sum += count;
  }
  for (let i = 0; i < n; i++) {
    const one = from[backwards ? n - 1 - i : i];
    to[counts[keys[one] >>> shift & 65535]++] = one;
  }
}

/** The Gaussians before the near plane, farthest first. */
function sort({ forward: [a, b, c], offset, near, number }) {
  const total = means.length / 3;
  if (keys?.length !== total) [keys, order, other] = [1, 2, 3].map(() => new Uint32Array(total));
  const depths = new Float32Array(keys.buffer);
  let n = 0;
  for (let i = 0; i < total; i++) {
    depths[i] = a * means[3 * i] + b * means[3 * i + 1] + c * means[3 * i + 2] - offset;
    if (depths[i] > near) order[n++] = i; // bits of positive floats order as they do
  }
  pass(order, other, n, 0, true);
  pass(other, order, n, 16, false);
  const sorted = order.slice(0, n);
  postMessage({ sorted, number }, [sorted.buffer]);
}

onmessage = async ({ data }) => {
  try {
    if (data.model) await open(data);
    else sort(data);
  } catch (error) {
    postMessage({ fault: error.message });
  }
};
