// Numbers as colours, and as words.

let turbo; // 256 colours, red, green, blue

function turboColour(fraction) {
  const start = 3 * Math.round(255 * fraction);
  return turbo.subarray(start, start + 3);
}

class Scale {
  constructor({ low, high, logarithmic }) {
    Object.assign(this, { low, high, logarithmic });
  }

  fraction(value) {
    const place = this.logarithmic ? Math.log : (number) => number;
    return clamp((place(value) - place(this.low)) / (place(this.high) - place(this.low)), 0, 1);
  }

  colour(value) {
    return Number.isNaN(value) ? [128, 128, 128] : turboColour(this.fraction(value));
  }

  get ticks() {
    const ticks = this.logarithmic ? this.#ratios() : roundNumbers(this.low, this.high, 7);
    return ticks.filter((value) => value >= this.low && value <= this.high);
  }

  #ratios() {
    const first = Math.floor(Math.log10(this.low));
    const powers = Array.from({ length: Math.ceil(Math.log10(this.high)) - first + 1 }, (_, i) => 10 ** (first + i));
    const choices = [[1, 1.5, 2, 3, 5, 7], [1, 2, 5], [1, 3], [1]].map((steps) =>
      powers.flatMap((power) => steps.map((step) => power * step)).filter((v) => v >= this.low && v <= this.high),
    );
    return choices.find((ticks) => ticks.length <= 8) ?? [this.low, this.high];
  }
}

function roundStep(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [1, 2, 5, 10].find((step) => step * power >= length * (1 - 1e-9));
}

// Round numbers from low to high, at most so many.
function roundNumbers(low, high, most) {
  const step = roundStep((high - low) / most);
  const numbers = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) numbers.push(i * step);
  return numbers;
}

const words = (value) => String(Number(value.toPrecision(4)));

// A length with as many digits as its error leaves: the last one is uncertain.
function lengthWords(value, error) {
  return value.toFixed(decimals(error));
}

// A length and its standard deviation, of which two digits are given.
function withSigma(value, sigma) {
  const digits = decimals(sigma / 10);
  return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)}`;
}

const decimals = (error) => (error > 0 ? clamp(Math.ceil(-Math.log10(error)), 0, 9) : 4);
