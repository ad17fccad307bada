// Reads a recording with the packages that Foxglove and Lichtblick read files with: by its indexes, each message decoded by the
// definition in the file. Prints what it read as JSON. It judges nothing.
//
// node recording.mjs FILE TOPIC: also counts the messages of that topic in the second half of the time, as a viewer that seeks.
import { open } from "node:fs/promises";

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const [path, topic] = process.argv.slice(2);
const file = await open(path, "r");
const readable = new FileHandleReadable(file);
const decompressHandlers = await loadDecompressHandlers();
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });

const decoders = new Map();
for (const { id, schemaId } of reader.channelsById.values()) {
  const text = new TextDecoder().decode(reader.schemasById.get(schemaId).data);
  decoders.set(id, new MessageReader(parse(text, { ros2: true })));
}

const topics = {};
let before = 0n;
let isSorted = true;
for await (const message of reader.readMessages()) {
  const { channelId, logTime, data } = message;
  const value = decoders.get(channelId).readMessage(data);
  const { topic: name } = reader.channelsById.get(channelId);
  const seen = (topics[name] ??= { count: 0, first: logTime.toString() });
  seen.count += 1;
  Object.assign(seen, { last: logTime.toString(), value });
  isSorted &&= logTime >= before;
  before = logTime;
}

const { messageStartTime, messageEndTime, channelMessageCounts } = reader.statistics;
const startTime = (messageStartTime + messageEndTime) / 2n;
let half = 0;
for await (const message of reader.readMessages({ topics: [topic], startTime })) {
  half += message.logTime >= startTime ? 1 : Number.NaN;
}
const counts = Object.fromEntries(
  [...channelMessageCounts].map(([id, count]) => [reader.channelsById.get(id).topic, Number(count)]),
);
const { profile, library } = reader.header;
await file.close();
const plain = (_, value) => (typeof value === "bigint" ? value.toString() : ArrayBuffer.isView(value) ? [...value] : value);
console.log(JSON.stringify({ profile, library, topics, counts, isSorted, half, startTime }, plain));
