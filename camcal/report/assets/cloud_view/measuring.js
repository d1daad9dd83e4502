// Which point is clicked, and how far two are from each other.

const REACH = 7; // pixels around the click
const SAME_SURFACE = 0.02; // of the distance to the centre: what lies no deeper is not hidden

// The point under a pixel, null where there is none: of those nearby that nothing hides, the nearest to the pixel.
function pick(cloud, viewpoint, x, y) {
  const candidates = [];
  let nearest = Infinity;
  const [m, size] = [viewpoint.matrix(cloud.middle), viewpoint.size];
  const { places, count } = cloud;
  for (let i = 0; i < count; i++) {
    const [a, b, c] = [places[3 * i], places[3 * i + 1], places[3 * i + 2]];
    const w = m[3] * a + m[7] * b + m[11] * c + m[15];
    if (w <= 0) continue;
    const across = ((m[0] * a + m[4] * b + m[8] * c + m[12]) / w + 1) * (size[0] / 2) - x;
    const below = (1 - (m[1] * a + m[5] * b + m[9] * c + m[13]) / w) * (size[1] / 2) - y;
    const away = across * across + below * below;
    if (away > REACH * REACH) continue;
    const [, , distance] = viewpoint.project(cloud.seen(i));
    if (distance < (viewpoint.parallel ? -Infinity : viewpoint.near)) continue;
    candidates.push({ index: i, away, distance });
    nearest = Math.min(nearest, distance);
  }
  const limit = nearest + SAME_SURFACE * viewpoint.distance;
  const front = candidates.filter((candidate) => candidate.distance <= limit);
  return front.length ? front.reduce((best, other) => (other.away < best.away ? other : best)).index : null;
}

// Distance of two points in the unit of the file; sigma: its standard deviation, null if it is not known.
// A disparity moves a point along its ray from the camera; the errors of two points are taken for independent.
function measure(cloud, first, second) {
  const ends = [first, second].map((index) => ({ place: cloud.seen(index), sigma: cloud.sigma(index) }));
  const difference = subtract(ends[1].place, ends[0].place);
  const distance = norm(difference);
  const known = cloud.facts.from_camera && distance > 0 && ends.every((end) => end.sigma !== null);
  const moves = ends.map((end) => (dot(difference, end.place) / distance / end.place[2]) * end.sigma);
  return { distance, sigma: known ? Math.hypot(...moves) : null, error: 2 * cloud.facts.packed.error };
}
