/** Divides in place of the square of a smaller length [m²], or of the area that segments span [m⁴]. */
const TINY_AREA = 1e-12;

/** Whether an arm at joints `[n]` is above the table, and its links do not meet, by its capsules. */
function freeOfContact(arm, capsules, q) {
  const frames = arm.frames(q);
  const at = capsules.links.map((link, i) => [capsules.starts[i], capsules.ends[i]].map((point) => {
    if (!link) return point;
    const { rotation, position } = frames.links[link - 1];
    return add(position, turned(rotation, point));
  }));
  const above = at.every(([start, end], i) =>
    capsules.floors[i] === null || Math.min(start[2], end[2]) - capsules.radii[i] > capsules.floors[i]);
  return above && capsules.pairs.every(([i, j]) =>
    segmentDistance(at[i], at[j]) > capsules.radii[i] + capsules.radii[j]);
}

/** Distance [m] between two segments (Ericson, "Real-Time Collision Detection", 2005, section 5.1.9). */
function segmentDistance([start, end], [otherStart, otherEnd]) {
  const along = minus(end, start), across = minus(otherEnd, otherStart), between = minus(start, otherStart);
  const a = dot(along, along), e = dot(across, across), b = dot(along, across);
  const c = dot(along, between), f = dot(across, between);
  let s = clip((b * f - c * e) / Math.max(a * e - b * b, TINY_AREA), 0, 1);
  const t = clip((b * s + f) / Math.max(e, TINY_AREA), 0, 1);
  s = clip((b * t - c) / Math.max(a, TINY_AREA), 0, 1);
  return norm(minus(add(between, times(along, s)), times(across, t)));
}
