// A drive as Lichtblick's own client gets it, under the old name of the protocol, which is the one it asks for.
//
//     node viewer.js ws://HOST:PORT/
//
// Subscribes to all channels until the server hangs up and prints one JSON object: messages by topic. It exits 1 where a
// message of a JSON channel is no JSON.
'use strict'
const path = require('path')
const { createRequire } = require('module')
const installed = createRequire(path.join(process.cwd(), 'package.json')) // run.py installs them there
const { FoxgloveClient } = installed('@foxglove/ws-protocol')
const { WebSocket } = installed('ws')

const counts = {}
const channels = new Map() // by the subscription's number
const client = new FoxgloveClient({ ws: new WebSocket(process.argv[2], [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) })
client.on('error', (error) => { console.error(error); process.exit(1) })
client.on('advertise', (advertised) => {
  for (const channel of advertised) channels.set(client.subscribe(channel.id), channel)
})
client.on('message', ({ subscriptionId, data }) => {
  const { topic, encoding } = channels.get(subscriptionId)
  if (encoding === 'json') JSON.parse(new TextDecoder().decode(data))
  counts[topic] = (counts[topic] ?? 0) + 1
})
client.on('close', () => console.log(JSON.stringify({ counts })))
