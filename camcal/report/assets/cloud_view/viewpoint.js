// From where the cloud is looked at. Frame: x right, y down, z forward; pixels are those of the style sheet.

const MARGIN = 1.06;
const PANELS = 110; // pixels of the height that panels cover
const NEAREST = 0.01; // of the distance to the centre; what is nearer is not drawn

class Viewpoint {
  constructor(view, reach) {
    this.reach = reach; // from the centre to the farthest point
    this.size = [1, 1];
    this.take(view);
  }

  take(view) {
    this.target = [...view.target];
    this.azimuth = view.azimuth;
    this.elevation = view.elevation;
    this.distance = view.distance;
    this.opening = [view.half_width / view.distance, view.half_height / view.distance];
    this.parallel = view.parallel;
  }

  get axes() {
    const [sa, ca] = [Math.sin(this.azimuth), Math.cos(this.azimuth)];
    const [se, ce] = [Math.sin(this.elevation), Math.cos(this.elevation)];
    return [[ca, 0, sa], [se * sa, ce, -se * ca], [-sa * ce, se, ca * ce]];
  }

  get eye() {
    return subtract(this.target, scaled(this.axes[2], this.distance));
  }

  get focal() {
    const [width, height] = [this.size[0], Math.max(this.size[1] - PANELS, this.size[1] / 2)];
    const wanted = Math.max(this.opening[0] / width, this.opening[1] / height, 1e-9);
    return 1 / (2 * wanted * MARGIN);
  }

  get near() {
    return Math.max(this.distance - this.reach(this.target), NEAREST * this.distance);
  }

  get far() {
    return this.distance + this.reach(this.target);
  }

  // Pixel and distance of a point; the distance is negative behind the viewer.
  project(point) {
    const [right, down, forward] = rotated(this.axes, subtract(point, this.eye));
    const scale = this.focal / (this.parallel ? this.distance : forward);
    return [this.size[0] / 2 + right * scale, this.size[1] / 2 + down * scale, forward];
  }

  // Column-major 4 x 4 for points given from `origin`.
  matrix(origin) {
    const [right, down, forward] = this.axes;
    const [width, height] = this.size;
    const start = subtract(origin, this.eye);
    const scale = this.parallel ? this.focal / this.distance : this.focal;
    const near = this.parallel ? this.distance - this.reach(this.target) : this.near;
    const span = this.far - near;
    const row = (axis, factor, offset = 0) => [...scaled(axis, factor), factor * dot(axis, start) + offset];
    const rows = [
      row(right, (2 * scale) / width),
      row(down, (-2 * scale) / height),
      this.parallel
        ? row(forward, 2 / span, -(this.far + near) / span)
        : row(forward, (this.far + near) / span, (-2 * this.far * near) / span),
      this.parallel ? [0, 0, 0, 1] : row(forward, 1),
    ];
    return new Float32Array([0, 1, 2, 3].flatMap((column) => rows.map((values) => values[column])));
  }

  // Pixels per unit at a distance of one, or at any distance in a parallel projection.
  get pixels() {
    return this.parallel ? this.focal / this.distance : this.focal;
  }

  orbit(right, down) {
    this.azimuth -= right;
    this.elevation = clamp(this.elevation + down, -Math.PI / 2, Math.PI / 2);
  }

  pan(right, down) {
    const [across, below] = this.axes;
    const unit = this.distance / this.focal;
    this.target = subtract(this.target, add(scaled(across, right * unit), scaled(below, down * unit)));
  }

  zoom(factor) {
    this.distance = clamp(this.distance / factor, 1e-4 * this.reach(this.target), 50 * this.reach(this.target));
  }

  // Turn about another point without moving the eye along the line of sight.
  centre(point) {
    const forward = dot(this.axes[2], subtract(point, this.eye));
    if (!this.parallel) this.distance = Math.max(forward, NEAREST * this.distance);
    this.target = [...point];
  }
}
