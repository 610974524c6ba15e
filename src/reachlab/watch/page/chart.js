/** Least distance that the chart tells from none, in success distances, and its points at most. */
const LEAST = 0.05, POINTS = 400;

/** The distance to the goal over the time of an episode, on a logarithmic scale, for each arm that is shown. */
class Chart {
  constructor(part) {
    this.part = part;
    this.near = part.querySelector("line");
    this.ways = [];
  }

  /** Begin with as many arms of a run. */
  begin({ rules, goal, workspace }, count) {
    const far = norm(minus(workspace.high, workspace.low)), { success_distance: near } = rules;
    Object.assign(this, { least: Math.log(LEAST * near), most: Math.log(far), steps: rules.max_steps, moves: goal.moves });
    const height = this.height(near);
    Object.entries({ y1: height, y2: height }).forEach(([name, value]) => this.near.setAttribute(name, value));
    this.ways.forEach(({ line }) => line.remove());
    this.ways = Array.from({ length: count }, (_, i) => {
      const line = document.createElementNS(this.part.namespaceURI, "polyline");
      line.setAttribute("class", i ? "other" : "");
      this.part.append(line);
      return { line, points: [] };
    });
  }

  /** Note where the players are now. */
  note(players) {
    players.forEach(({ episode, path }, i) => {
      const way = this.ways[i], last = way.points[way.points.length - 1], same = way.path === path;
      if (same && last && last[0] === episode.clock) return;
      if (!same || (last && last[0] > episode.clock)) Object.assign(way, { points: [], path });
      way.points.push([episode.clock, this.height(episode.distance)]);
      if (way.points.length > POINTS) way.points.shift();
    });
  }

  /** Draw what was noted. */
  draw() {
    for (const { line, points } of this.ways.filter((way) => way.points.length)) {
      const [[first]] = points, wide = Math.max(this.steps, points[points.length - 1][0] - first);
      line.setAttribute("points", points.map(([x, y]) => `${((100 * (x - first)) / wide).toFixed(1)},${y.toFixed(1)}`).join(" "));
    }
  }

  /** How far below the upper edge a distance [m] is drawn, of 100. */
  height(distance) {
    return 100 - (100 * (Math.log(Math.max(distance, 1e-9)) - this.least)) / (this.most - this.least);
  }
}
