// Files from the web, with their progress, and errors that say what to do.

const KB = 1e3;
const MB = 1e6;

export function sizeOf(bytes) {
  return bytes < MB ? `${Math.round(bytes / KB)} kB` : `${(bytes / MB).toFixed(bytes < 10 * MB ? 1 : 0)} MB`;
}

// The bytes at `url`. `progress` gets the bytes so far and the total, 0 if the server does not say.
export async function download(url, progress, signal) {
  const name = nameOf(url);
  let response;
  try {
    response = await fetch(url, { signal });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Error(unreachable(url));
  }
  if (response.status === 404) throw new Error(`The file ${name} is not there (404): check the address ${url}`);
  if (!response.ok) throw new Error(`The file ${name} could not be loaded: the server answered ${response.status} ${response.statusText}`);
  // The length of a compressed answer is not that of the file.
  const plain = !response.headers.get("content-encoding");
  const total = plain ? Number(response.headers.get("content-length")) || 0 : 0;
  let bytes = new Uint8Array(total || 1 << 20);
  let size = 0;
  const reader = response.body.getReader();
  for (;;) {
    let part;
    try {
      part = await reader.read();
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new Error(cut(name, size, total));
    }
    if (part.done) break;
    if (size + part.value.length > bytes.length) {
      const larger = new Uint8Array(Math.max(2 * bytes.length, size + part.value.length));
      larger.set(bytes.subarray(0, size));
      bytes = larger;
    }
    bytes.set(part.value, size);
    size += part.value.length;
    progress(size, total);
  }
  if (size < total) throw new Error(cut(name, size, total));
  return bytes.subarray(0, size);
}

// The content that a page in one file has under `name`.
export async function embedded(name) {
  const text = atob(document.getElementById(`file-${name}`).textContent);
  const bytes = new Uint8Array(text.length);
  for (let at = 0; at < text.length; at += 1) bytes[at] = text.charCodeAt(at);
  const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(unpacked).arrayBuffer());
}

export function nameOf(url) {
  return decodeURIComponent(new URL(url).pathname.split("/").pop()) || url;
}

// Only what a page may load: no scripts in addresses.
export function webAddress(text, base) {
  const url = new URL(text, base);
  if (!["http:", "https:", "blob:"].includes(url.protocol)) throw new Error(`"${text}" is not an address of the web.`);
  return url.href;
}

export function unreachable(url) {
  const { origin, protocol } = new URL(url);
  if (protocol === "blob:" || origin === location.origin) return `The address ${url} could not be reached: is the server running?`;
  return `The address ${url} could not be read. Either ${origin} cannot be reached, or it does not let other sites read its files: `
    + `it has to send the header "Access-Control-Allow-Origin: *" (CORS).`;
}

function cut(name, size, total) {
  const of = total ? ` of ${sizeOf(total)}` : "";
  return `The download of ${name} ended after ${sizeOf(size)}${of}: load the page again.`;
}
