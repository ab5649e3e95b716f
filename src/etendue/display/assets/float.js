// Floating-point pictures from text: planes of mantissas and an exponent [Ward 1991], deflated, in base64.
// value = mantissa 2^(exponent - 136)

const inflate = async (text) => {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};

/** Whether this browser can decode pictures. */
export const canUnpack = () => typeof DecompressionStream !== "undefined";

/** Interleaved channels of `layer`, {planes, channels, width, height}, as a Float32Array. */
export const unpack = async ({ planes, channels, width, height }) => {
  const bytes = await inflate(planes), count = width * height, exponents = channels * count;
  const scale = Float64Array.from({ length: 256 }, (_, e) => 2 ** (e - 136));
  const values = new Float32Array(count * channels);
  for (let i = 0; i < count; i++) {
    const unit = scale[bytes[exponents + i]];
    for (let c = 0; c < channels; c++) values[channels * i + c] = bytes[c * count + i] * unit;
  }
  return values;
};
