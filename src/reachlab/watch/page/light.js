/** Where the lamp and the one across from it stand, as directions that need no length. */
const LAMP_AT = [0.9, -1.1, 2.2], FILL_AT = [-1.2, 0.8, 0.8];

/** Strength of the light from above and from below, of the lamp and of the one across, and of the shine. */
const LIGHTS = { SKY: 0.56, GROUND: 0.28, LAMP: 0.58, FILL: 0.16, SHINE: 0.1 };

/**
 * Light is computed where vertices are, which lie close together, and not for every pixel: a computer without a
 * graphics card draws so in two thirds of the time.
 */
const VERTEX_SHADER = `
uniform vec3 colour;
varying vec3 shade;

void main() {
  vec4 place = modelMatrix * vec4(position, 1.0);
  vec3 outward = normalize(mat3(modelMatrix) * normal), lamp = normalize(${vec3(LAMP_AT)});
  vec3 halfway = normalize(lamp + normalize(cameraPosition - place.xyz));
  float light = mix(GROUND, SKY, 0.5 + 0.5 * outward.z) + LAMP * max(dot(outward, lamp), 0.0)
    + FILL * max(dot(outward, normalize(${vec3(FILL_AT)})), 0.0);
  float once = max(dot(outward, halfway), 0.0), twice = once * once, eighth = twice * twice * twice * twice;
  vec3 linear = colour * light + SHINE * eighth * eighth * eighth; // by products: a power takes longer in software
  shade = pow(linear, vec3(1.0 / 2.2));
  gl_Position = projectionMatrix * viewMatrix * place;
}`;

/** Each vertex has a colour of its own, as it is on the screen: nothing is computed for a pixel. */
const TINTED_SHADER = `
attribute vec3 tint;
varying vec3 shade;

void main() {
  shade = tint;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

const FRAGMENT_SHADER = `
uniform float opacity;
varying vec3 shade;

void main() {
  gl_FragColor = vec4(shade, opacity);
}`;

/** A vector as shaders write it. */
function vec3(numbers) {
  return `vec3(${numbers.map((x) => x.toFixed(4)).join()})`;
}

/** A surface of a colour, in the light of the scene. */
function shaded(colour, opacity = 1) {
  const clear = opacity < 1, strengths = Object.entries(LIGHTS).map(([name, x]) => [name, x.toFixed(4)]);
  return new THREE.ShaderMaterial({
    defines: Object.fromEntries(strengths),
    uniforms: { colour: { value: rgb(colour) }, opacity: { value: opacity } },
    vertexShader: VERTEX_SHADER,
    fragmentShader: FRAGMENT_SHADER,
    transparent: clear,
    depthWrite: !clear,
  });
}

/** A surface in the colours of its vertices, `tint`, in no light. */
function tinted(settings) {
  return new THREE.ShaderMaterial({
    uniforms: { opacity: { value: 1 } },
    vertexShader: TINTED_SHADER,
    fragmentShader: FRAGMENT_SHADER,
    ...settings,
  });
}

/** A colour of three numbers from 0 to 1, as they are on the screen. */
function rgb([red, green, blue]) {
  return new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace);
}
