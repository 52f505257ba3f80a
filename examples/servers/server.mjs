// A policy server in JavaScript:  npm install ws @msgpack/msgpack  &&  node server.mjs 8000
// Then:  gn0 bench run SUITE --policy remote --policy-option url=ws://127.0.0.1:8000 --out OUT
import { decode, encode } from "@msgpack/msgpack";
import { WebSocketServer } from "ws";

const port = Number(process.argv[2] ?? 8000);
const server = new WebSocketServer({ host: "127.0.0.1", port, maxPayload: 16 << 20 });

// {__ndarray__: true, data: Uint8Array, dtype: "<f4", shape: [72]} → numbers and their shape
const KINDS = { "|u1": Uint8Array, "<f4": Float32Array, "<f8": Float64Array };
function readArray(found) {
  const bytes = Uint8Array.from(found.data); // a buffer of its own, aligned
  return { shape: found.shape, values: new KINDS[found.dtype](bytes.buffer) };
}

server.on("connection", (socket) => {
  // "keys": "text" asks for maps that JavaScript can hold; "wants" names the observation fields
  socket.send(encode({ gn0: { version: 1, name: "javascript", wants: ["ranges"], keys: "text" } }));
  let asked = 0;
  socket.on("message", (frame) => {
    const request = decode(frame);
    if (request.endpoint === "reset") {
      asked = 0;
      socket.send(encode({ status: "ok" }));
      return;
    }
    const ranges = readArray(request.gn0.ranges); // metres, counter-clockwise, the first ahead
    const ahead = Math.min(ranges.values[0], ranges.values[1], ranges.values.at(-1));
    asked += 1;
    const action = asked > 60 ? 0 : ahead > 0.8 ? 1 : 2; // STOP, FORWARD, LEFT: your model goes here
    socket.send(encode({ action_type: "discrete", actions: [action] }));
  });
});
server.on("listening", () => console.log(`ws://127.0.0.1:${server.address().port}`));
