// The page: controls, panels, and the picture whenever something has changed.

class Page {
  constructor(facts, cloud) {
    Object.assign(this, { facts, cloud, chosen: [], waiting: false });
    this.canvas = element("points");
    this.viewpoint = new Viewpoint(facts.start, this.#reach());
    this.painter = new Painter(this.canvas, cloud);
    this.drawing = new Drawing(element("drawing"), facts);
    this.gestures = new Gestures(this.canvas, this.viewpoint, {
      changed: () => this.change(),
      clicked: (x, y) => this.#click(x, y),
      centred: (x, y) => this.#centre(x, y),
    });
    this.#fillControls();
    this.#listen();
    element("statistics").textContent = facts.statistics;
    element("size").value = Math.log2(facts.point_size);
    this.#resize(0);
    this.colourBy(facts.colour);
  }

  // The distance from a point to the farthest corner of all points.
  #reach() {
    const { view_T_cloud: turn, packed } = this.facts;
    const last = packed.origin.map((start, axis) => start + 65535 * packed.step[axis]);
    const ends = [packed.origin, last].map((corner) => rotated(turn, corner));
    return (point) =>
      Math.max(norm([0, 1, 2].map((i) => Math.max(...ends.map((end) => Math.abs(end[i] - point[i]))))), 1e-9);
  }

  #fillControls() {
    const select = element("colour");
    for (const mode of this.cloud.modes) select.add(new Option(mode, mode));
    const keys = { camera: "C", front: "F", top: "T", side: "S" };
    for (const name of Object.keys(this.facts.views)) {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: name, title: `key ${keys[name]}` });
      button.addEventListener("click", () => this.show(name));
      element("views").append(button);
    }
  }

  #listen() {
    element("colour").addEventListener("change", (event) => this.colourBy(event.target.value));
    element("size").addEventListener("input", () => this.#resize(0));
    element("parallel").addEventListener("click", () => this.#toggleProjection());
    element("axes").addEventListener("click", () => this.#toggleAxes());
    element("clear").addEventListener("click", () => this.clear());
    addEventListener("resize", () => this.change());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.change());
    addEventListener("keydown", (event) => this.#key(event));
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || /SELECT|INPUT/.test(event.target.tagName)) return;
    const step = Math.PI / 36;
    const actions = {
      r: () => this.restart(),
      home: () => this.restart(),
      c: () => this.show("camera"),
      f: () => this.show("front"),
      t: () => this.show("top"),
      s: () => this.show("side"),
      p: () => this.#toggleProjection(),
      a: () => this.#toggleAxes(),
      escape: () => this.clear(),
      "+": () => this.#resize(0.25),
      "=": () => this.#resize(0.25),
      "-": () => this.#resize(-0.25),
      arrowleft: () => this.viewpoint.orbit(-step, 0),
      arrowright: () => this.viewpoint.orbit(step, 0),
      arrowup: () => this.viewpoint.orbit(0, -step),
      arrowdown: () => this.viewpoint.orbit(0, step),
      pageup: () => this.viewpoint.zoom(1.2),
      pagedown: () => this.viewpoint.zoom(1 / 1.2),
    };
    const action = actions[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action();
    this.change();
  }

  show(name) {
    this.viewpoint.take(this.facts.views[name]);
    this.change();
  }

  restart() {
    this.viewpoint.take(this.facts.start);
    this.change();
  }

  colourBy(mode) {
    element("colour").value = mode;
    this.painter.colour(this.cloud.colours(mode));
    this.#showLegend(mode);
    this.change();
  }

  #resize(by) {
    const slider = element("size");
    slider.value = Number(slider.value) + by;
    this.pointSize = 2 ** slider.value;
    this.change();
  }

  #toggleProjection() {
    this.viewpoint.parallel = !this.viewpoint.parallel;
    this.change();
  }

  #toggleAxes() {
    this.drawing.axes = !this.drawing.axes;
    this.change();
  }

  #showLegend(mode) {
    const given = this.facts.scales[mode];
    element("legend").hidden = !given;
    if (!given) return;
    const scale = new Scale(given);
    const stops = Array.from({ length: 33 }, (_, i) => `rgb(${turboColour(i / 32)})`);
    document.querySelector("#legend figcaption").textContent = `${mode}, ${this.facts.unit}`;
    document.querySelector("#legend .ramp").style.background = `linear-gradient(to top, ${stops})`;
    document.querySelector("#legend .ticks").replaceChildren(
      ...scale.ticks.map((value) => {
        const tick = document.createElement("span");
        tick.textContent = words(value);
        tick.style.bottom = `${100 * scale.fraction(value)}%`;
        return tick;
      }),
    );
  }

  #click(x, y) {
    const index = pick(this.cloud, this.viewpoint, x, y);
    if (index === null) return;
    this.choose(this.chosen.length === 1 ? [this.chosen[0], index] : [index]);
  }

  #centre(x, y) {
    const index = pick(this.cloud, this.viewpoint, x, y);
    this.clear();
    if (index !== null) this.viewpoint.centre(this.cloud.seen(index));
    this.change();
  }

  clear() {
    this.choose([]);
  }

  choose(indices) {
    this.chosen = indices;
    element("clear").disabled = !indices.length;
    const line = element("measured");
    line.hidden = !indices.length;
    line.replaceChildren(...this.#measuredWords());
    this.change();
  }

  #measuredWords() {
    const { unit, packed } = this.facts;
    const points = this.chosen.map((index) => {
      const sigma = this.cloud.sigma(index);
      const place = this.cloud.point(index).map((value) => lengthWords(value, packed.error)).join(", ");
      return `(${place})${sigma === null ? "" : ` σ ${Number(sigma.toPrecision(2))}`}`;
    });
    const result = document.createElement("b");
    result.textContent = this.#label();
    return [result, ` ${points.join(" to ")} ${unit}`];
  }

  #label() {
    if (this.chosen.length < 2) return "";
    const { distance, sigma, error } = measure(this.cloud, ...this.chosen);
    const length = sigma > error ? withSigma(distance, sigma) : lengthWords(distance, error);
    return `${length} ${this.facts.unit}`;
  }

  // Ask for a picture; many changes before it cost one.
  change() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    const size = [innerWidth, innerHeight];
    for (const canvas of [this.canvas, this.drawing.canvas]) {
      const [width, height] = size.map((length) => Math.round(length * devicePixelRatio));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    }
    this.viewpoint.size = size;
    const style = pageStyle();
    this.painter.draw(this.viewpoint, this.pointSize, style.paperNumbers);
    this.drawing.top = element("controls").getBoundingClientRect().bottom + 24;
    this.drawing.draw(this.viewpoint, style, this.chosen.map((index) => this.cloud.seen(index)), this.#label());
    element("parallel").setAttribute("aria-pressed", this.viewpoint.parallel);
    element("axes").setAttribute("aria-pressed", this.drawing.axes);
  }
}

const element = (id) => document.getElementById(id);

function pageStyle() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(`--${name}`).trim();
  const paper = colour("paper");
  return {
    paper,
    paperNumbers: [1, 3, 5].map((start) => parseInt(paper.slice(start, start + 2), 16) / 255),
    ink: colour("ink"),
    mark: colour("mark"),
    axes: ["x", "y", "z"].map((axis) => colour(`axis-${axis}`)),
  };
}

async function openPage() {
  const facts = JSON.parse(element("facts").textContent);
  turbo = Uint8Array.from(atob(facts.turbo), (letter) => letter.charCodeAt(0));
  const cloud = new Cloud(facts, await inflate(element("packed").textContent));
  const page = new Page(facts, cloud);
  page.draw();
  return page;
}

// For scripts that drive the page: everything by the number of a point.
const opened = openPage();
window.camcalView = {
  ready: opened.then((page) => page.cloud.count),
  point: async (index) => (await opened).cloud.point(index),
  project: async (index) => (await opened).viewpoint.project((await opened).cloud.seen(index)),
  pick: async (x, y) => pick((await opened).cloud, (await opened).viewpoint, x, y),
  measure: async (first, second) => measure((await opened).cloud, first, second),
  chosen: async () => (await opened).chosen,
  colourBy: async (mode) => (await opened).colourBy(mode),
  show: async (name) => (await opened).show(name),
};

opened.catch((error) => {
  element("failure").textContent = `The cloud cannot be shown: ${error.message} A current browser with WebGL is needed.`;
  element("failure").hidden = false;
});
