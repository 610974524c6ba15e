/* Begins the page: all that it holds is compressed, and its runs may come later than what draws and moves them. */

/** Bytes of a text in base64. */
function bytesOf(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Bytes that a part of the page holds, which is compressed by zlib and written in base64. */
async function inflated(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

/** Bytes of a part by its name. */
function part(name) {
  return inflated(document.getElementById(name).textContent);
}

/** Text of a part by its name. */
async function text(name) {
  return new TextDecoder().decode(await part(name));
}

/** MuJoCo's engine, which the page holds compressed. */
async function loadEngine() {
  const [wasmBinary, glue] = await Promise.all(["wasm", "glue"].map(part));
  const script = URL.createObjectURL(new Blob([glue], { type: "text/javascript" }));
  const { default: load } = await import(script);
  URL.revokeObjectURL(script);
  return load({ wasmBinary, locateFile: (name) => name }); // it would else look for a file beside the page
}

/** What is being made ready while the runs are still on their way. */
const prepared = {};

/** Make ready what draws, and the engine where there is one. */
function prepare() {
  if (typeof DecompressionStream === "undefined") throw new Error("it takes a browser of 2023 or later");
  prepared.drawing = text("three").then((code) => (0, eval)(code));
  prepared.engine = document.getElementById("wasm") ? loadEngine() : null;
  prepared.engine?.catch(fail);
}

/** Show the runs, which are there now. */
async function start() {
  prepared.started = true;
  await prepared.drawing;
  (0, eval)(await text("script"));
}

/** Say in the page that it cannot be shown, and why. */
function fail(error) {
  const said = document.getElementById("hint");
  said.hidden = false;
  said.textContent = `This page cannot be shown here: ${error.message}`;
  said.className = "failed";
}

window.addEventListener("DOMContentLoaded", () => {
  if (!prepared.started) fail(new Error("what serves it ended before all of it was there; its terminal says why."));
});
