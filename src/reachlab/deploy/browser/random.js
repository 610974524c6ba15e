/** Random numbers of a seed: Mulberry32 (Tommy Ettinger, 2017, public domain). */
class Random {
  constructor(seed) {
    this.state = seed >>> 0;
  }

  /** A number from `low` to `high`. */
  uniform(low = 0, high = 1) {
    this.state = (this.state + 0x6d2b79f5) >>> 0;
    let mixed = this.state;
    mixed = Math.imul(mixed ^ (mixed >>> 15), mixed | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return low + (high - low) * (((mixed ^ (mixed >>> 14)) >>> 0) / 4294967296);
  }

  /** A vector between two others. */
  between(low, high) {
    return low.map((x, i) => this.uniform(x, high[i]));
  }

  /** A number of the exponential distribution of mean 1. */
  exponential() {
    return -Math.log(1 - this.uniform());
  }

  /** A direction `[3]`, each as likely as any other. */
  direction() {
    const z = this.uniform(-1, 1), turn = this.uniform(0, 2 * Math.PI), out = Math.sqrt(1 - z * z);
    return [out * Math.cos(turn), out * Math.sin(turn), z];
  }
}
