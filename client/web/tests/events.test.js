import assert from "node:assert/strict";
import { createServer } from "node:http";
import test from "node:test";

import { parseEvent, reopenDelayMs, watchEvents } from "../events.js";

/**
 * A server that answers request after request as it is told; keeps what it was asked.
 * @param {((request: import("node:http").IncomingMessage, response: import("node:http").ServerResponse) => void)[]} answers
 */
async function serve(answers) {
  const asked = [];
  const server = createServer((request, response) => {
    asked.push(request.headers);
    const answer = answers[asked.length - 1];
    if (answer) answer(request, response);
    else response.writeHead(401).end();
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const { port } = server.address();
  const close = () => {
    server.closeAllConnections();
    return new Promise((resolve) => server.close(resolve));
  };
  return { asked, url: `http://127.0.0.1:${port}/events`, close };
}

const stream = (response) => response.writeHead(200, { "Content-Type": "text/event-stream" });

/** Until something holds. @param {() => boolean} holds */
async function until(holds) {
  for (let i = 0; i < 500 && !holds(); i += 1) await new Promise((resolve) => setTimeout(resolve, 10));
  assert.ok(holds());
}

test("after a 503, a broken and an ended stream it comes back, later each time, and goes on behind the last event", async () => {
  const server = await serve([
    (_, response) => response.writeHead(503, { "Retry-After": "2" }).end("busy"),
    (_, response) => {
      stream(response).write("retry: 2000\nevent: scene\nid: 7\ndata: {\"a\":7}\n\n: alive\n\nevent: gap\ndata: {}\n\n");
      setTimeout(() => response.destroy(), 20);
    },
    (_, response) => stream(response).end("event: scene\nid: 8\ndata: 8\n\n"),
    (_, response) => stream(response).end(""),
  ]);
  const events = [];
  const waits = [];
  watchEvents(server.url, (name, data) => events.push([name, data]), {
    wait: (ms) => {
      waits.push(ms);
      return Promise.resolve();
    },
    random: () => 1,
  });
  // The fifth request is refused for good.
  await until(() => server.asked.length === 5);
  await new Promise((resolve) => setTimeout(resolve, 50));
  assert.equal(server.asked.length, 5);
  assert.deepEqual(events, [["scene", '{"a":7}'], ["gap", "{}"], ["scene", "8"]]);
  assert.deepEqual(server.asked.map((headers) => headers["last-event-id"]), [undefined, undefined, "7", "8", "8"]);
  assert.deepEqual(waits, [2000 + 500, 1000, 2000, 4000]);
  await server.close();
});

test("a line that says nothing is given up, one that says anything is not, and who ends it is asked no more", async () => {
  let comments = 0;
  const server = await serve([
    (_, response) => stream(response).write(": once\n\n"),
    (_, response) => {
      stream(response).write(": first\n\n");
      const timer = setInterval(() => {
        comments += 1;
        response.write(": alive\n\n");
      }, 20);
      response.on("close", () => clearInterval(timer));
    },
  ]);
  const end = watchEvents(server.url, () => {}, { wait: () => Promise.resolve(), silence_ms: 150 });
  await until(() => comments > 20);
  assert.equal(server.asked.length, 2);
  end();
  const before = comments;
  await new Promise((resolve) => setTimeout(resolve, 100));
  assert.ok(comments <= before + 2 && server.asked.length === 2);
  await server.close();
});

test("waits double up to a bound, half of each is random, and come after what the server asks for", () => {
  assert.equal(reopenDelayMs(1, null, 0), 250);
  assert.equal(reopenDelayMs(1, null, 1), 500);
  assert.equal(reopenDelayMs(3, null, 1), 2000);
  assert.equal(reopenDelayMs(99, null, 1), 15_000);
  assert.equal(reopenDelayMs(1, "5", 1), 5500);
  assert.equal(reopenDelayMs(1, "86400", 1), 60_500);
  for (const odd of ["", "-3", "soon", "Wed, 21 Oct 2015 07:28:00 GMT"]) assert.equal(reopenDelayMs(1, odd, 1), 500);
});

test("an event's name, its id and its lines of data are read, comments are not", () => {
  assert.deepEqual(parseEvent('event: scene\nid: 5\ndata: {"a":1}'), { name: "scene", data: '{"a":1}', id: "5" });
  assert.deepEqual(parseEvent("data:a\r\ndata: b\r\n: comment"), { name: "message", data: "a\nb", id: null });
  assert.deepEqual(parseEvent(": keep-alive"), { name: "message", data: "", id: null });
});
