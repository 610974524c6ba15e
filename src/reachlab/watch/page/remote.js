/* Arms that the page does not compute: Python moves them while it serves the page, or they were recorded for it. */

/** Steps that are asked for at once; the time after which the arm is looked at where nothing is, and after an error [ms]. */
const MOST_STEPS = 50, GLANCE = 200, RETRY = 2000;

/** Where Python listens, and the name of this page among others that it serves. */
const ADDRESS = "play", PAGE = String(Math.random());

/** A moment that the page was told. */
class Told extends Moment {
  constructor(run, message) {
    super(run);
    this.state = this.ended = message;
  }

  frames() {
    const { axes, positions, fingers } = this.state;
    return { links: rows(axes, positions), fingers };
  }
}

/** What all arms have in common that the page is told of, see `Player`. */
class Listener {
  constructor(run) {
    Object.assign(this, { run, steps: 0, episodes: 0, successes: 0, over: false, failed: "", reachable: true });
    this.clear();
  }

  clear() {
    Object.assign(this, { path: new Trace(PATH_STEP), trail: new Trace(TRAIL_STEP) });
  }

  /** Take in what was told of a moment. */
  take(message) {
    if (message.begun !== this.begun) this.clear();
    this.begun = message.begun;
    this.episode = new Told(this.run, message);
    for (const name of ["steps", "episodes", "successes", "over", "failed", "reachable", "picture"]) this[name] = message[name];
    this.path.add(message.tool);
    if (this.episode.moves) this.trail.add(this.episode.goal);
  }
}

/** An arm that Python moves: what is asked for is gathered until the answer to what was asked before is there. */
class Remote extends Listener {
  /** An arm of a run; `failed` is told where it cannot be moved, and why. */
  constructor(run, failed) {
    super(run);
    Object.assign(this, { asked: { steps: 0 }, waits: false, refused: failed, looked: -Infinity, barred: 0 });
  }

  /** Whether it takes no other step now. */
  get busy() {
    return !this.episode || this.asked.steps >= MOST_STEPS;
  }

  begin() {
    this.asked = this.episode ? { begin: true, steps: 0 } : { steps: 0 }; // the first page finds an arm at its begin
  }

  step(agent, wanted) {
    this.asked.agent = agent === BY_HAND ? "ik" : agent;
    if (agent === BY_HAND) this.asked.command = [...wanted];
    this.asked.steps++;
  }

  proceed() {
    this.asked.proceed = true;
    this.over = false;
  }

  follow(following) {
    this.following = following;
  }

  moveGoal(position, turn) {
    this.asked.goal = [...position, ...(turn ?? [])];
  }

  moveBody(number, position) {
    this.asked.body = [number, ...position];
  }

  /** Ask for what was gathered, or look at the arm, unless an answer is still awaited. */
  async exchange(now) {
    const idle = !this.asked.steps && Object.keys(this.asked).length === 1;
    if (this.waits || now < this.barred || (idle && now - this.looked < GLANCE)) return;
    const asked = { run: this.run.number, follow: Boolean(this.following), ...this.asked };
    Object.assign(this, { waits: true, asked: { steps: 0 }, looked: now });
    try {
      const headers = { "Content-Type": "application/json", "X-Page": PAGE };
      const answer = await fetch(ADDRESS, { method: "POST", headers, body: JSON.stringify(asked) });
      const told = await answer.json();
      if (!answer.ok) throw new Error(told.error);
      this.take(told);
      this.refused("");
    } catch (error) {
      this.refused(error instanceof TypeError ? "What serves this page has ended." : error.message);
      this.barred = now + RETRY;
    }
    this.waits = false;
  }
}

/** Episodes that were recorded, one after the other. */
class Recording extends Listener {
  constructor(run) {
    super(run);
    Object.assign(this, { record: run.facts.record, number: -1 });
    this.begin();
  }

  begin() {
    this.number = (this.number + 1) % this.record.length;
    Object.assign(this, { at: 0, waited: undefined });
    this.clear();
    this.take(this.record[this.number][0]);
  }

  /** Go on by a control step: not every one was recorded. */
  step() {
    const moments = this.record[this.number], next = Math.min(this.at + 1, moments.length - 1);
    this.waited = (this.waited ?? this.episode.clock) + 1;
    if (this.waited < moments[next].clock[0]) return;
    Object.assign(this, { at: next, waited: undefined });
    this.take(moments[next]);
    this.over = next === moments.length - 1;
  }

  proceed() {
    this.begin();
  }

  follow() {}
  moveGoal() {}
  moveBody() {}
}
