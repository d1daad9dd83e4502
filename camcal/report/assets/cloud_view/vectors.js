// Three numbers, and three rows of them.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const scaled = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
const norm = (a) => Math.hypot(...a);
const rotated = (rows, a) => rows.map((row) => dot(row, a));
const between = (a, b, share) => add(a, scaled(subtract(b, a), share));
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
