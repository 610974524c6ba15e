/* Vectors `[k]` as arrays, matrices `[3, 3]` as arrays of rows, quaternions wxyz. */

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

/** Size of the largest component. */
function largest(a) {
  let most = 0;
  for (let i = 0; i < a.length; i++) most = Math.max(most, Math.abs(a[i]));
  return most;
}

/** A matrix times a vector `[3]`. */
function turned(matrix, a) {
  return [dot(matrix[0], a), dot(matrix[1], a), dot(matrix[2], a)];
}

/** Column `[3]` of a matrix. */
function column(matrix, i) {
  return [matrix[0][i], matrix[1][i], matrix[2][i]];
}

/** Product of two matrices. */
function product(a, b) {
  return a.map((row) => [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));
}

/** A matrix with rows and columns exchanged. */
function transposed(matrix) {
  return [column(matrix, 0), column(matrix, 1), column(matrix, 2)];
}

/** Axes as columns `[3, 3]` of an orientation `[4]`. */
function rotationOf([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** Unit quaternion `[4]` with w >= 0 of an orientation `[3, 3]` (Shepperd 1978). */
function quaternionOf([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]]) {
  const rows = [
    [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
    [zy - yz, 1 + xx - yy - zz, yx + xy, xz + zx],
    [xz - zx, yx + xy, 1 - xx + yy - zz, zy + yz],
    [yx - xy, xz + zx, zy + yz, 1 - xx - yy + zz],
  ];
  let best = 0;
  for (let i = 1; i < 4; i++) if (rows[i][i] > rows[best][best]) best = i;
  return times(rows[best], (rows[best][0] < 0 ? -0.5 : 0.5) / Math.sqrt(rows[best][best]));
}

/** Rotation vector `[3]` from one orientation to another, as 2 sin(θ/2) times the axis. */
function rotationError(current, target) {
  return times(quaternionOf(product(target, transposed(current))).slice(1), 2);
}

/** Angle [rad] of a rotation error, which is twice the sine of its half. */
function angleOf(turn) {
  return 2 * Math.asin(Math.min(norm(turn) / 2, 1));
}

/** Solution `[m]` of a symmetric positive system `[m, m]`, by Cholesky's factors, which take the matrix's place. */
function solvePositive(matrix, right) {
  const m = right.length, x = right.slice();
  for (let i = 0; i < m; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = matrix[i][j];
      for (let k = 0; k < j; k++) sum -= matrix[i][k] * matrix[j][k];
      matrix[i][j] = i === j ? Math.sqrt(sum) : sum / matrix[j][j];
    }
    for (let k = 0; k < i; k++) x[i] -= matrix[i][k] * x[k];
    x[i] /= matrix[i][i];
  }
  for (let i = m - 1; i >= 0; i--) {
    for (let k = i + 1; k < m; k++) x[i] -= matrix[k][i] * x[k];
    x[i] /= matrix[i][i];
  }
  return x;
}

/** Damped least-squares step `[n]` of a Jacobian's columns `[n, m]` for an error `[m]`. */
function leastSquares(columns, error, damping) {
  const m = error.length, gram = [];
  for (let i = 0; i < m; i++) {
    gram.push(new Array(m).fill(0));
    for (let j = 0; j <= i; j++) for (const one of columns) gram[i][j] += one[i] * one[j];
    gram[i][i] += damping;
  }
  const weights = solvePositive(gram, error);
  return columns.map((one) => dot(one, weights));
}
