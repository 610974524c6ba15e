/* Vectors `[k]` as arrays. */

/** Sum of the products of two vectors. */
function dot(a, b) {
  let sum = 0;
  for (let i = 0; i < a.length; i++) sum += a[i] * b[i];
  return sum;
}

/** Sum of two vectors. */
function add(a, b) {
  return a.map((x, i) => x + b[i]);
}

/** Difference of two vectors. */
function minus(a, b) {
  return a.map((x, i) => x - b[i]);
}

/** A vector times a number. */
function times(a, factor) {
  return a.map((x) => factor * x);
}

/** Length of a vector. */
function norm(a) {
  return Math.sqrt(dot(a, a));
}

/** Vector product `[3]`. */
function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** A number between two others. */
function clip(x, low, high) {
  return Math.min(Math.max(x, low), high);
}

/** A vector between two others. */
function clipped(a, low, high) {
  return a.map((x, i) => clip(x, low[i], high[i]));
}

/** A vector of length 1 in the same direction. */
function unit(a) {
  return times(a, 1 / norm(a));
}

/** Product of two quaternions, wxyz: the rotation by the second and then by the first. */
function product([a, ...u], [b, ...v]) {
  return [a * b - dot(u, v), ...add(add(times(v, a), times(u, b)), cross(u, v))];
}

/** A vector `[3]` rotated by a quaternion, wxyz. */
function rotated([w, ...u], a) {
  const twice = times(cross(u, a), 2);
  return add(add(a, times(twice, w)), cross(u, twice));
}

/** The least rotation from one unit vector to another, as a quaternion, wxyz. */
function rotation(from, to) {
  return unit([1 + dot(from, to) + 1e-9, ...cross(from, to)]);
}
