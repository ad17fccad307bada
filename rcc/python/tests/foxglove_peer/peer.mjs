// A viewer of the Foxglove WebSocket with the packages of Foxglove itself: it subscribes every channel, decodes every message by the
// schema that the server advertises, and prints what it saw as JSON. It judges nothing.
//
// node peer.mjs URL SUBPROTOCOL MESSAGES [SERVICE REQUEST]: ends after so many messages of the topic with the most.

import protocol from "@foxglove/ws-protocol";
import rosmsg from "@foxglove/rosmsg";
import serialization from "@foxglove/rosmsg2-serialization";
import WebSocket from "ws";

/** Longest run, ms. */
const TIME_MAX = 60000;

const [url, subprotocol, most, service, request] = process.argv.slice(2);
const seen = { subprotocol: "", info: null, topics: {}, parameters: null, response: null, statuses: [], failures: [] };
const channels = new Map(), services = new Map();
let isOver = false;

const socket = new WebSocket(url, [subprotocol]);
const client = new protocol.FoxgloveClient({ ws: socket });

function end(failure) {
  if (isOver) return;
  isOver = true;
  if (failure) seen.failures.push(failure);
  const text = JSON.stringify(seen, (_, value) =>
    typeof value === "bigint" ? Number(value) : ArrayBuffer.isView(value) ? [...value] : Number.isNaN(value) ? null : value);
  process.stdout.write(text + "\n", () => process.exit(0));
}

setTimeout(() => end("no end within " + TIME_MAX + " ms"), TIME_MAX);
client.on("open", () => { seen.subprotocol = socket.protocol; });
client.on("error", error => end("error: " + (error?.message ?? error)));
client.on("close", () => end("closed"));
client.on("status", status => seen.statuses.push(status));
client.on("serverInfo", info => {
  seen.info = info;
  client.getParameters([], "all");
});
client.on("parameterValues", ({ parameters, id }) => { if (id === "all") seen.parameters = parameters; });
client.on("advertiseServices", offered => {
  for (const it of offered) {
    services.set(it.name, it);
    if (it.name !== service) continue;
    const data = new TextEncoder().encode(request ?? "{}");
    client.sendServiceCallRequest({ serviceId: it.id, callId: 7, encoding: "json", data: new DataView(data.buffer) });
  }
});
client.on("serviceCallResponse", response => {
  seen.response = { call: response.callId, encoding: response.encoding, text: new TextDecoder().decode(response.data) };
});
client.on("serviceCallFailure", failure => { seen.response = { call: failure.callId, failure: failure.message }; });
client.on("advertise", advertised => {
  for (const channel of advertised) {
    const topic = { encoding: channel.encoding, schemaEncoding: channel.schemaEncoding, schema: channel.schemaName, count: 0, first: null, last: null };
    seen.topics[channel.topic] = topic;
    try {
      const reader = new serialization.MessageReader(rosmsg.parse(channel.schema, { ros2: true }));
      channels.set(client.subscribe(channel.id), { topic, reader, name: channel.topic });
    } catch (error) {
      seen.failures.push(channel.topic + ": schema: " + error.message);
    }
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const channel = channels.get(subscriptionId);
  if (!channel) { seen.failures.push("a message of no subscription"); return; }
  const { topic, reader, name } = channel;
  try {
    const message = { time: timestamp, value: reader.readMessage(data) };
    topic.first ??= message;
    topic.last = message;
    topic.count++;
  } catch (error) {
    if (seen.failures.length < 20) seen.failures.push(name + ": " + error.message);
  }
  const isAnswered = !service || seen.response;
  if (topic.count >= Number(most) && isAnswered && seen.parameters) end();
});
