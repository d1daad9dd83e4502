// The points: unpacked, and their colours.

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Running sums undo the differences from point to point.
function undoDifferences16(low, high) {
  const counts = new Uint16Array(low.length);
  for (let i = 0, sum = 0; i < low.length; i++) {
    sum = (sum + low[i] + 256 * high[i]) & 0xffff;
    counts[i] = sum;
  }
  return counts;
}

function undoDifferences8(differences) {
  const values = new Uint8Array(differences.length);
  for (let i = 0, sum = 0; i < values.length; i++) {
    sum = (sum + differences[i]) & 0xff;
    values[i] = sum;
  }
  return values;
}

class Cloud {
  constructor(facts, bytes) {
    this.facts = facts;
    const { count, colours, sigma } = facts.packed;
    this.count = count;
    let start = 0;
    const plane = () => bytes.subarray(start, (start += count));
    this.counts = [0, 1, 2].map(() => undoDifferences16(plane(), plane()));
    this.rgb = colours ? this.#colours(plane(), plane(), plane()) : null;
    this.sigmaCodes = sigma ? plane() : null;
    this.middle = scaled(add(facts.box[0], facts.box[1]), 0.5);
    this.places = this.#places();
  }

  #colours(green, red, blue) {
    const rgb = new Uint8Array(3 * this.count);
    const [g, r, b] = [green, red, blue].map(undoDifferences8);
    for (let i = 0; i < this.count; i++) {
      rgb[3 * i] = r[i] + g[i];
      rgb[3 * i + 1] = g[i];
      rgb[3 * i + 2] = b[i] + g[i];
    }
    return rgb;
  }

  // What the graphics card gets: x right, y down, z forward, from the middle of the box so that float32 is fine enough.
  #places() {
    const places = new Float32Array(3 * this.count);
    const { view_T_cloud: turn, packed } = this.facts;
    for (let row = 0; row < 3; row++) {
      const factors = turn[row].map((part, axis) => part * packed.step[axis]);
      const base = dot(turn[row], packed.origin) - this.middle[row];
      for (let i = 0; i < this.count; i++) {
        places[3 * i + row] =
          base + factors[0] * this.counts[0][i] + factors[1] * this.counts[1][i] + factors[2] * this.counts[2][i];
      }
    }
    return places;
  }

  // A point in the frame of the file, in double precision.
  point(index) {
    const { origin, step } = this.facts.packed;
    return origin.map((start, axis) => start + step[axis] * this.counts[axis][index]);
  }

  // A point x right, y down, z forward.
  seen(index) {
    return rotated(this.facts.view_T_cloud, this.point(index));
  }

  sigma(index) {
    const code = this.sigmaCodes ? this.sigmaCodes[index] : 0;
    return code ? this.facts.packed.sigma[0] * this.facts.packed.sigma[1] ** (code - 1) : null;
  }

  get modes() {
    return ["image", "depth", "sigma", "gray"].filter(
      (mode) => !(mode === "image" && !this.rgb) && !(mode === "sigma" && !this.sigmaCodes),
    );
  }

  colours(mode) {
    if (mode === "depth") return this.#scaled(mode, (i) => this.places[3 * i + 2] + this.middle[2]);
    if (mode === "sigma") return this.#scaled(mode, (i) => this.sigma(i) ?? NaN);
    return mode === "gray" ? this.#gray() : this.rgb;
  }

  #scaled(mode, value) {
    const colours = new Uint8Array(3 * this.count);
    const scale = new Scale(this.facts.scales[mode]);
    for (let i = 0; i < this.count; i++) {
      colours.set(scale.colour(value(i)), 3 * i);
    }
    return colours;
  }

  #gray() {
    const colours = new Uint8Array(3 * this.count).fill(150);
    for (let i = 0; this.rgb && i < this.count; i++) {
      const light = 0.299 * this.rgb[3 * i] + 0.587 * this.rgb[3 * i + 1] + 0.114 * this.rgb[3 * i + 2];
      colours.fill(light, 3 * i, 3 * i + 3);
    }
    return colours;
  }
}
