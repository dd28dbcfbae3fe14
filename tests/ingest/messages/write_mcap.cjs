// SPDX-License-Identifier: Apache-2.0
// Messages, one JSON object a line on standard input, written by @mcap/core: node write_mcap.cjs FILE
const { McapWriter } = require("@mcap/core");
const { createInterface } = require("node:readline");
const { open } = require("node:fs/promises");

class FileWritable {
  constructor(handle) {
    this.handle = handle;
    this.length = 0n;
  }
  async write(buffer) {
    this.length += BigInt((await this.handle.write(buffer)).bytesWritten);
  }
  position() {
    return this.length;
  }
}

async function main(path) {
  const handle = await open(path, "w");
  const writer = new McapWriter({ writable: new FileWritable(handle), chunkSize: 2048 });
  await writer.start({ profile: "ros2", library: "test" });
  const channels = new Map();
  for await (const line of createInterface({ input: process.stdin })) {
    const { topic, type, logTime, data } = JSON.parse(line);
    if (!channels.has(topic)) {
      const schemaId = await writer.registerSchema({ name: type, encoding: "ros2msg", data: new Uint8Array() });
      const channel = { topic, schemaId, messageEncoding: "cdr", metadata: new Map() };
      channels.set(topic, await writer.registerChannel(channel));
    }
    const time = BigInt(logTime);
    const content = new Uint8Array(Buffer.from(data, "base64"));
    await writer.addMessage({ channelId: channels.get(topic), sequence: 0, logTime: time, publishTime: time, data: content });
  }
  await writer.end();
  await handle.close();
}

main(process.argv[2]).catch((error) => {
  console.error(error);
  process.exit(1);
});
