/* Begins the page: its other scripts are compressed. */

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

/** Say in the page that it cannot be shown, and why. */
function fail(error) {
  const said = document.getElementById("hint");
  said.textContent = `This page cannot be shown here: ${error.message}`;
  said.className = "failed";
}

Promise.all(["three", "script"].map(part)).then((codes) => {
  for (const code of codes) (0, eval)(new TextDecoder().decode(code));
}).catch(fail);
