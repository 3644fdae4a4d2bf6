// Numbers: base64 of gzipped planes of bytes, as pgm/viewer/numbers.py packs them.

async function unpacked(text) {
  const letters = atob(text.trim());
  const bytes = new Uint8Array(letters.length);
  for (let k = 0; k < bytes.length; k++) bytes[k] = letters.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / 8;
  const whole = new Uint8Array(planes.length);
  for (let plane = 0; plane < 8; plane++) {
    const from = plane * count;
    for (let k = 0; k < count; k++) whole[8 * k + plane] = planes[from + k];
  }
  return new Float64Array(whole.buffer);
}

// An array of rows, kept column by column.
class Rows {
  constructor(numbers, ref) {
    this.rows = ref.rows;
    this.columns = ref.columns;
    this.data = numbers.subarray(ref.at, ref.at + ref.rows * ref.columns);
  }

  at(row, column) {
    return this.data[column * this.rows + row];
  }

  row(row) {
    const found = new Float64Array(this.columns);
    for (let k = 0; k < this.columns; k++) found[k] = this.at(row, k);
    return found;
  }

  column(column) {
    return this.data.subarray(column * this.rows, (column + 1) * this.rows);
  }
}
