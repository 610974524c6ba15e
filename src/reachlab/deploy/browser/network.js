/** Numbers of an array that is sent as base64 of float32. */
function decoded({ data }) {
  return new Float32Array(bytesOf(data).buffer);
}

/** Bytes of a text in base64. */
function bytesOf(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Actions of observations: a normaliser, and layers with tanh between them. */
class Network {
  /** The network of a policy's weights by name, and its facts. */
  constructor(weights, facts) {
    this.layers = [];
    for (let i = 0; weights[`actor.${i}.weight`]; i++) {
      this.layers.push([decoded(weights[`actor.${i}.weight`]), decoded(weights[`actor.${i}.bias`])]);
    }
    this.mean = decoded(weights["normaliser.mean"]);
    this.scale = decoded(weights["normaliser.scale"]);
    this.centre = decoded(weights["action.centre"]);
    this.half = decoded(weights["action.half"]);
    this.clip = facts.observation_clip;
  }

  /** Action `[a]` of an observation `[k]`, not yet clipped to its box. */
  act(vector) {
    let x = vector.map((number, i) => clip((number - this.mean[i]) / this.scale[i], -this.clip, this.clip));
    this.layers.forEach((layer, i) => {
      x = dense(layer, x);
      if (i < this.layers.length - 1) x = x.map(Math.tanh);
    });
    return Array.from(x, (number, i) => this.centre[i] + this.half[i] * number);
  }
}

/** `x W + b`, of weights `[k, m]` row by row. */
function dense([weight, bias], x) {
  const sum = Float64Array.from(bias), m = sum.length;
  for (let i = 0, row = 0; i < x.length; i++, row += m) {
    for (let j = 0; j < m; j++) sum[j] += x[i] * weight[row + j];
  }
  return sum;
}
