// What is drawn over the points: axes, the camera, a scale bar, the measurement.

const SHORTEST = 25; // pixels of an axis that is worth labels

class Drawing {
  constructor(canvas, facts) {
    Object.assign(this, { canvas, facts, context: canvas.getContext("2d"), axes: true, top: 24 });
  }

  // chosen: places of the points that were clicked; label: what is written between two of them.
  draw(viewpoint, style, chosen, label) {
    const { canvas, context } = this;
    const ratio = canvas.width / viewpoint.size[0];
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, ...viewpoint.size);
    context.font = "12px system-ui, sans-serif";
    Object.assign(this, { viewpoint, style });
    if (this.axes) {
      this.#axes();
      this.#camera();
    }
    this.#scaleBar();
    this.#measurement(chosen, label);
  }

  #line(a, b, colour, width = 1) {
    const ends = this.#visible(a, b);
    if (!ends) return;
    const { context } = this;
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    context.moveTo(...ends[0]);
    context.lineTo(...ends[1]);
    context.stroke();
  }

  // The pixels of the ends of a line, cut off before the viewer; null if all of it is behind.
  #visible(a, b) {
    const { viewpoint } = this;
    const near = viewpoint.parallel ? -Infinity : viewpoint.near;
    const [from, to] = [a, b].map((end) => viewpoint.project(end)[2]);
    if (from < near && to < near) return null;
    const cut = (end, other, here, there) => (here < near ? between(end, other, (near - here) / (there - here)) : end);
    return [cut(a, b, from, to), cut(b, a, to, from)].map((end) => viewpoint.project(end).slice(0, 2));
  }

  #text(words, x, y, colour, align = "center") {
    const { context, style } = this;
    context.textAlign = align;
    context.textBaseline = "middle";
    context.lineJoin = "round";
    context.lineWidth = 4;
    context.strokeStyle = style.paper;
    context.strokeText(words, x, y);
    context.fillStyle = colour;
    context.fillText(words, x, y);
  }

  // Three edges of the box from its corner at the lower left in front, each with its axis of the file and its length.
  #axes() {
    const { box, view_T_cloud: turn, unit } = this.facts;
    const corner = [box[0][0], box[1][1], box[0][2]];
    const ends = [box[1][0], box[0][1], box[1][2]];
    ends.forEach((end, edge) => {
      const axis = turn[edge].findIndex((part) => Math.abs(part) > 0.5);
      const colour = this.style.axes[axis];
      const stop = corner.map((value, i) => (i === edge ? end : value));
      if (this.#pixels(corner, stop) < SHORTEST) return;
      this.#line(corner, stop, colour, 1.5);
      this.#ticks(corner, edge, end, turn[edge][axis], colour);
      const tip = between(corner, stop, 1.04);
      const [x, y, distance] = this.viewpoint.project(tip);
      const length = words(Math.abs(end - corner[edge]));
      if (this.#isShown(distance)) this.#text(`${"xyz"[axis]}  ${length} ${unit}`, x, y, colour);
    });
  }

  #ticks(corner, edge, end, sign, colour) {
    const [low, high] = [sign * corner[edge], sign * end].sort((a, b) => a - b);
    const outward = edge === 0 ? [0, 1, 0] : [-1, 0, 0];
    const size = 0.012 * this.viewpoint.distance * Math.max(...this.viewpoint.opening);
    for (const value of roundNumbers(low, high, 5)) {
      const from = corner.map((start, i) => (i === edge ? sign * value : start));
      this.#line(from, add(from, scaled(outward, size)), colour);
      const [x, y, distance] = this.viewpoint.project(add(from, scaled(outward, 3 * size)));
      if (this.#isShown(distance)) this.#text(words(value), x, y, colour);
    }
  }

  // How long a line is in the picture; none at all if it is behind the viewer.
  #pixels(a, b) {
    const ends = this.#visible(a, b);
    return ends ? Math.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]) : 0;
  }

  #isShown(distance) {
    return this.viewpoint.parallel || distance > this.viewpoint.near;
  }

  // A small pyramid where the camera stood, as wide as what it saw.
  #camera() {
    const { from_camera: known, tangents, depth } = this.facts;
    if (!known || norm(this.viewpoint.eye) < 0.4 * depth) return;
    const [[left, top], [right, bottom]] = tangents;
    const far = 0.06 * depth;
    const corners = [[left, top], [right, top], [right, bottom], [left, bottom]].map(([x, y]) => [x * far, y * far, far]);
    corners.forEach((corner, i) => {
      this.#line([0, 0, 0], corner, this.style.ink);
      this.#line(corner, corners[(i + 1) % 4], this.style.ink);
    });
  }

  // A round length, as it looks at the distance of the centre.
  #scaleBar() {
    const { viewpoint, style, context } = this;
    const perUnit = viewpoint.focal / viewpoint.distance;
    const length = roundStep(90 / perUnit);
    const [right, top] = [viewpoint.size[0] - 16, this.top];
    const width = length * perUnit;
    context.fillStyle = style.ink;
    context.fillRect(right - width, top, width, 4);
    const where = viewpoint.parallel ? "" : " at the centre";
    this.#text(`${words(length)} ${this.facts.unit}${where}`, right, top - 10, style.ink, "right");
  }

  #measurement(chosen, label) {
    const { context, style, viewpoint } = this;
    if (chosen.length === 2) this.#line(...chosen, style.mark, 2);
    for (const place of chosen) {
      const [x, y, distance] = viewpoint.project(place);
      if (!this.#isShown(distance)) continue;
      context.fillStyle = style.mark;
      context.strokeStyle = style.paper;
      context.lineWidth = 1.5;
      context.beginPath();
      context.arc(x, y, 4.5, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }
    const ends = chosen.length === 2 && this.#visible(...chosen);
    if (ends) this.#text(label, (ends[0][0] + ends[1][0]) / 2, (ends[0][1] + ends[1][1]) / 2 - 12, style.mark);
  }
}
