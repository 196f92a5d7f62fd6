import assert from "node:assert/strict";
import { createServer } from "node:http";
import test from "node:test";

import { SceneEditor, mergePatch } from "../scene-edit.js";

/** A server of one document, with the interface that the page uses; keeps what it was asked to change. */
async function serve() {
  const revisions = [{ version: 1, a: 0, b: 0, time: { rate: 1 } }];
  const asked = [];
  let reads = 0;
  const newest = () => revisions.length;
  const apply = (patch) => revisions.push({ ...revisions.at(-1), ...patch });
  const server = createServer((request, response) => {
    const url = new URL(request.url, "http://sky.test");
    let body = "";
    request.on("data", (part) => (body += part));
    request.on("end", () => {
      const answer = (status) =>
        response.writeHead(status, { "Content-Type": "application/json", ETag: `"${newest()}"` }).end(JSON.stringify(revisions.at(-1)));
      if (request.method === "GET") {
        reads += 1;
        return answer(200);
      }
      asked.push({ method: request.method, group: url.searchParams.get("group"), body: JSON.parse(body), match: request.headers["if-match"] });
      if (request.headers["if-match"] !== `"${newest()}"`) return answer(412);
      if (url.pathname.endsWith("revert")) revisions.push(revisions[asked.at(-1).body.revision - 1]);
      else apply(asked.at(-1).body);
      return answer(200);
    });
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const base = `http://127.0.0.1:${server.address().port}/`;
  const plainFetch = globalThis.fetch;
  globalThis.fetch = (target, init) => plainFetch(new URL(target, base), init);
  const close = () => {
    globalThis.fetch = plainFetch;
    server.closeAllConnections();
    return new Promise((resolve) => server.close(resolve));
  };
  return { asked, apply, close, newest, reads: () => reads };
}

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Until nothing is left to be sent. @param {SceneEditor} editor */
async function sent(editor) {
  for (let i = 0; i < 300 && mergePatch(editor.state.document, editor.state.draft) !== undefined; i += 1) await pause(10);
  await pause(30);
}

test("what is dragged is one group and one step however long the slider is held, and the next drag another", async () => {
  const server = await serve();
  const problems = [];
  const editor = new SceneEditor((text, bad) => bad && problems.push(text));
  await editor.load();
  const first = {};
  for (const value of [1, 2, 3]) {
    editor.edit(["a"], value, first);
    await pause(140);
  }
  await pause(1300); // held still
  editor.edit(["a"], 4, first);
  await sent(editor);
  const of_first = server.asked.length;
  assert.ok(of_first >= 3, `${of_first} patches`);
  await pause(1300); // let go
  const second = {};
  for (const value of [5, 6]) {
    editor.edit(["b"], value, second);
    await pause(140);
  }
  await sent(editor);
  const groups = server.asked.map(({ group }) => group);
  assert.match(groups[0], /^[0-9a-f]{16}$/);
  assert.deepEqual(new Set(groups.slice(0, of_first)).size, 1);
  assert.deepEqual(new Set(groups.slice(of_first)).size, 1);
  assert.notEqual(groups[0], groups[of_first]);
  // Each patch was made from what the one before had made.
  assert.deepEqual(server.asked.map(({ match }) => match), groups.map((_, i) => `"${i + 1}"`));
  await editor.undo();
  assert.deepEqual([editor.state.document.a, editor.state.document.b], [4, 0]);
  await editor.undo();
  assert.deepEqual([editor.state.document.a, editor.state.can_undo], [0, false]);
  assert.deepEqual(problems, []);
  await server.close();
});

test("an undo waits for what is being sent, and a step that began meanwhile goes back to what was seen", async () => {
  const server = await serve();
  const problems = [];
  const editor = new SceneEditor((text, bad) => bad && problems.push(text));
  await editor.load();
  editor.edit(["a"], 1, {});
  editor.beginStep();
  editor.edit(["b"], 2, {});
  await editor.undo();
  assert.deepEqual([editor.state.document.a, editor.state.document.b], [1, 0]);
  assert.deepEqual(problems, []);
  await server.close();
});

test("however many revisions are told of, the scene is read once for all that are known by then", async () => {
  const server = await serve();
  const editor = new SceneEditor(() => {});
  await editor.load();
  for (const a of [1, 2, 3, 4]) server.apply({ a });
  await Promise.all([2, 3, 4, 5].map((revision) => editor.load(revision)));
  await pause(50);
  assert.equal(editor.state.document.a, 4);
  assert.ok(server.reads() <= 3, `${server.reads()} reads`);
  const before = server.reads();
  await editor.load(3);
  assert.equal(server.reads(), before);
  await editor.load(); // a gap: whatever is known
  assert.equal(server.reads(), before + 1);
  await server.close();
});
