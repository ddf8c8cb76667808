// A scene in levels of detail: fetches the parts of files that the viewer asks for, by ranges of bytes.

import { download, unreachable } from "./download.js";

// The bytes of `part` of a file beside `base`.
export async function fetchPart(part, base, signal) {
  const url = new URL(part.file, base).href;
  const last = part.offset + part.bytes - 1;
  let response;
  try {
    response = await fetch(url, { signal, headers: { Range: `bytes=${part.offset}-${last}` } });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Error(unreachable(url));
  }
  const isWhole = part.offset === 0 && Number(response.headers.get("content-length")) === part.bytes;
  if (response.status === 200 && !isWhole) {
    response.body.cancel();
    throw new Error(`The server of ${url} ignores ranges of bytes: serve the folder with one that knows them, such as nginx, Apache or Caddy.`);
  }
  if (!response.ok) throw new Error(`${url}: the server answered ${response.status} ${response.statusText}`);
  const bytes = new Uint8Array(await response.arrayBuffer());
  if (bytes.length !== part.bytes) throw new Error(`${url} ended after ${bytes.length} of ${part.bytes} bytes.`);
  return bytes;
}

// Opens the scene whose index is at `url`. Resolves to what it is, as JSON, once its coarsest level is shown.
export async function openLevels(viewer, url, budget, progress, signal) {
  const index = await download(url, () => {}, signal);
  const parts = JSON.parse(viewer.open_levels(index, url));
  let came = 0;
  const fetches = parts.map(async (part) => {
    const bytes = await fetchPart(part, url, signal);
    came += 1;
    progress(came / parts.length);
    return bytes;
  });
  return viewer.show_levels(await Promise.all(fetches), budget);
}

// Fetches the cells that the last frame asked for, and calls `draw` as each has come or failed.
export function fetchWanted(viewer, base, draw, signal) {
  for (const { cell, ...part } of JSON.parse(viewer.wanted())) {
    fetchPart(part, base, signal).then(
      (bytes) => signal.aborted || viewer.take_cell(cell, bytes),
      (error) => {
        if (signal.aborted) return;
        console.warn(error.message);
        viewer.miss_cell(cell, error.message);
      },
    ).then(() => signal.aborted || draw());
  }
}
