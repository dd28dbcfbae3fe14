// SPDX-License-Identifier: Apache-2.0
// What @mcap/core sees in a file, as JSON: node read_mcap.cjs FILE
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const { readFile } = require("node:fs/promises");

async function main(path) {
  const data = new Uint8Array(await readFile(path));
  const readable = {
    size: async () => BigInt(data.byteLength),
    read: async (offset, size) => data.subarray(Number(offset), Number(offset + size)),
  };
  const decompressHandlers = await loadDecompressHandlers();
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const topics = {};
  for (const channel of reader.channelsById.values()) {
    topics[channel.topic] = reader.schemasById.get(channel.schemaId)?.name;
  }
  const counts = {};
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const topic = reader.channelsById.get(message.channelId).topic;
    counts[topic] = (counts[topic] ?? 0) + 1;
  }
  const attachments = [];
  for await (const attachment of reader.readAttachments()) attachments.push(attachment.name);
  const metadata = {};
  for await (const record of reader.readMetadata()) metadata[record.name] = Object.fromEntries(record.metadata);
  console.log(JSON.stringify({ topics, counts, attachments, metadata }));
}

main(process.argv[2]).catch((error) => {
  console.error(error);
  process.exit(1);
});
