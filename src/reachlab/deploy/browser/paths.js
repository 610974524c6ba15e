/* Paths of goals that move, as numbers: how they are drawn, and where the goal is after a time [s]. */

/** As in `reachlab.tasks.paths`, where each is explained. */
const LENGTH = 1 / 3, SMALLEST_RADIUS = 0.25, HARMONICS = [1, 1.6, 2.3], INSTANTS = 64, STAY = 1.5, DIRECTIONS = 64;

/** Kinds of path by name: `sample` gives the numbers of one, `at` the place `[3]` m and the velocity `[3]` m/s. */
const PATHS = {
  line: { sample: sampleLine, at: onLine },
  circle: { sample: sampleCircle, at: onCircle },
  smooth: { sample: sampleSmooth, at: onSmooth },
  jumps: { sample: sampleJumps, at: afterJumps },
};

function sampleLine({ low, high }, random, speed) {
  const ends = [random.between(low, high), random.between(low, high)];
  const size = minus(high, low), longest = size.indexOf(Math.max(...size)), part = LENGTH * size[longest];
  ends.forEach((end, i) => {
    end[longest] = (i ? high[longest] - part : low[longest]) + LENGTH * (end[longest] - low[longest]);
  });
  if (random.uniform() < 0.5) ends.reverse();
  return [speed, ...ends[0], ...ends[1]];
}

function onLine(numbers, time) {
  const speed = numbers[0], begin = numbers.slice(1, 4), way = minus(numbers.slice(4, 7), begin), length = norm(way);
  const gone = ((speed * time) / length) % 2, ahead = gone < 1;
  const position = add(begin, times(way, ahead ? gone : 2 - gone));
  return { position, velocity: times(way, (ahead ? speed : -speed) / length) };
}

function sampleCircle({ low, high }, random, speed) {
  const most = Math.min(...minus(high, low)) / 2, radius = random.uniform(SMALLEST_RADIUS * most, most);
  const one = random.direction(), beside = cross(one, random.direction()), other = times(beside, 1 / norm(beside));
  const inner = [low.map((x) => x + radius), high.map((x) => x - radius)];
  const centre = random.between(...inner), phase = random.uniform(0, 2 * Math.PI);
  return [speed / radius, phase, ...centre, ...times(one, radius), ...times(other, radius)];
}

function onCircle(numbers, time) {
  const turn = numbers[0] * time + numbers[1], cos = Math.cos(turn), sin = Math.sin(turn);
  const one = numbers.slice(5, 8), other = numbers.slice(8, 11);
  return {
    position: add(numbers.slice(2, 5), add(times(one, cos), times(other, sin))),
    velocity: times(minus(times(other, cos), times(one, sin)), numbers[0]),
  };
}

function sampleSmooth({ low, high }, random, speed) {
  const reach = low.map((x, i) => ((high[i] - x) / 2) * random.uniform(0.5, 1));
  const amplitudes = reach.flatMap((most) => {
    const shares = HARMONICS.map(() => random.exponential()), sum = shares.reduce((a, b) => a + b);
    return shares.map((share) => (most * share) / sum);
  });
  const centre = random.between(add(low, reach), minus(high, reach));
  const numbers = [1, ...centre, ...amplitudes, ...amplitudes.map(() => random.uniform(0, 2 * Math.PI))];
  let mean = 0;
  for (let i = 0; i < INSTANTS; i++) mean += norm(onSmooth(numbers, (2 * Math.PI * i) / (INSTANTS - 1)).velocity);
  numbers[0] = (speed * INSTANTS) / mean;
  return numbers;
}

function onSmooth(numbers, time) {
  const waves = HARMONICS.length, position = numbers.slice(1, 4), velocity = [0, 0, 0];
  for (let axis = 0; axis < 3; axis++) {
    for (let i = 0; i < waves; i++) {
      const amplitude = numbers[4 + waves * axis + i], rate = numbers[0] * HARMONICS[i];
      const turn = rate * time + numbers[4 + waves * (3 + axis) + i];
      position[axis] += amplitude * Math.sin(turn);
      velocity[axis] += rate * amplitude * Math.cos(turn);
    }
  }
  return { position, velocity };
}

function sampleJumps({ low, high }, random, speed, rules, period) {
  const places = [random.between(low, high)], count = Math.ceil((rules.max_steps * period) / STAY) + 1;
  while (places.length < count) {
    const last = places[places.length - 1];
    // From the middle of a small box no jump of that length stays inside: the longest one is taken that does.
    let there = last.map((x, i) => (x < (low[i] + high[i]) / 2 ? high[i] : low[i]));
    for (let i = 0; i < DIRECTIONS; i++) {
      const jump = add(last, times(random.direction(), rules.goal_jump));
      if (jump.every((x, axis) => x >= low[axis] && x <= high[axis])) {
        there = jump;
        break;
      }
    }
    places.push(there);
  }
  return places.flat();
}

function afterJumps(numbers, time, period) {
  // Half a period early, so that rounding does not decide between a jump and the next step.
  const number = clip(Math.floor((time + period / 2) / STAY), 0, numbers.length / 3 - 1);
  return { position: numbers.slice(3 * number, 3 * number + 3), velocity: [0, 0, 0] };
}
