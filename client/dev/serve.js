// @ts-check
/**
 * Serves files of this folder and passes everything else on to a Skycell server, so that page and server have one origin: for
 * the examples, for work on the page without building the server, and (with a delay) for tests of a slow line.
 *
 *     node dev/serve.js http://127.0.0.1:8080          # http://127.0.0.1:8090/examples/three/
 *
 * Not for the open network: it checks nothing.
 */

import { readFile } from "node:fs/promises";
import http from "node:http";
import net from "node:net";
import path from "node:path";
import { Transform } from "node:stream";
import { fileURLToPath } from "node:url";

const CLIENT = path.resolve(fileURLToPath(new URL("..", import.meta.url)));
/** @type {Record<string, string>} */
const KINDS = {
  ".html": "text/html; charset=utf-8",
  ".js": "text/javascript; charset=utf-8",
  ".css": "text/css; charset=utf-8",
  ".svg": "image/svg+xml",
  ".jpg": "image/jpeg",
  ".json": "application/json",
};

/**
 * Holds every piece back, in order.
 * @param {() => number} delayMs
 */
function delayed(delayMs) {
  /** What is on its way. @type {{ piece: Buffer, due_ms: number }[]} */
  const held = [];
  let last_due_ms = 0;
  /** @type {NodeJS.Timeout | undefined} */
  let timer;
  /** @type {(() => void) | undefined} */
  let ended;
  const line = new Transform({
    // Room for what is on its way: a line holds more than one piece.
    writableHighWaterMark: 1 << 24,
    readableHighWaterMark: 1 << 24,
    transform(piece, _encoding, done) {
      last_due_ms = Math.max(last_due_ms, performance.now() + delayMs());
      held.push({ piece, due_ms: last_due_ms });
      deliver();
      done();
    },
    flush(done) {
      ended = done;
      deliver();
    },
    destroy(error, done) {
      clearTimeout(timer);
      done(error);
    },
  });
  // One timer for the first of them: timers of their own may come in another order than they are due, and after the end.
  function deliver() {
    clearTimeout(timer);
    while (held.length > 0 && held[0].due_ms <= performance.now()) line.push(held.shift()?.piece);
    if (held.length > 0) timer = setTimeout(deliver, Math.max(1, held[0].due_ms - performance.now()));
    else ended?.();
  }
  return line;
}

/**
 * @param {object} options
 * @param {string} options.server  http://HOST:PORT
 * @param {number} [options.port]  0 for a free one
 * @param {string} [options.root]  folder of this one that stands at "/"
 * @param {() => number} [options.delayMs]  each way of the WebSocket
 * @returns {Promise<{ url: string, close: () => Promise<void> }>}
 */
export async function serve({ server, port = 0, root = ".", delayMs = () => 0 }) {
  const target = new URL(server);
  /** @type {Set<net.Socket>} */
  const sockets = new Set();
  const files = path.join(CLIENT, root);

  const gate = http.createServer(async (request, response) => {
    const { pathname } = new URL(request.url ?? "/", "http://localhost");
    const file = path.join(files, decodeURIComponent(pathname), pathname.endsWith("/") ? "index.html" : "");
    const kind = KINDS[path.extname(file)];
    if (file.startsWith(files + path.sep) && kind && !pathname.startsWith("/api/")) {
      try {
        const content = await readFile(file);
        response.writeHead(200, { "Content-Type": kind, "Cache-Control": "no-cache" }).end(content);
        return;
      } catch {
        // Not one of ours.
      }
    }
    const onward = http.request(
      { host: target.hostname, port: target.port, path: request.url, method: request.method, headers: request.headers },
      (answer) => {
        response.writeHead(answer.statusCode ?? 502, answer.headers);
        answer.pipe(response);
      },
    );
    onward.on("error", () => (response.headersSent ? response.destroy() : response.writeHead(502).end()));
    response.on("close", () => onward.destroy());
    request.pipe(onward);
  });

  gate.on("upgrade", (request, socket, head) => {
    const client = /** @type {net.Socket} */ (socket);
    const upstream = net.connect(Number(target.port || 80), target.hostname, () => {
      const lines = [`${request.method} ${request.url} HTTP/1.1`];
      for (let i = 0; i < request.rawHeaders.length; i += 2) lines.push(`${request.rawHeaders[i]}: ${request.rawHeaders[i + 1]}`);
      upstream.write(`${lines.join("\r\n")}\r\n\r\n`);
      upstream.write(head);
      client.pipe(delayed(delayMs)).pipe(upstream);
      upstream.pipe(delayed(delayMs)).pipe(client);
    });
    for (const [one, other] of [
      [client, upstream],
      [upstream, client],
    ]) {
      sockets.add(one);
      one.setNoDelay(true);
      one.on("error", () => other.destroy());
      one.on("close", () => {
        sockets.delete(one);
        other.destroy();
      });
    }
  });

  await new Promise((resolve) => gate.listen(port, "127.0.0.1", () => resolve(undefined)));
  const address = /** @type {net.AddressInfo} */ (gate.address());
  return {
    url: `http://127.0.0.1:${address.port}/`,
    close: async () => {
      for (const socket of sockets) socket.destroy();
      gate.closeAllConnections();
      await new Promise((resolve) => gate.close(() => resolve(undefined)));
    },
  };
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const [server = "http://127.0.0.1:8080", root = ".", port = "8090"] = process.argv.slice(2);
  const { url } = await serve({ server, root, port: Number(port) });
  console.log(`${url}${root === "." ? "examples/three/" : ""} in front of ${server}`);
}
