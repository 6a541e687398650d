// An ordinary socket.io-client (2 or 4) that plays simulator, stop and go; the twin of python_client.py.
//
//     node js_client.js 2|4 PORT polling|websocket|upgrade JPEG ROUNDS
//
// Each round sends a telemetry and wants a `steer` whose fields are text that
// reads as a number of -1 to 1, then sends null and wants `manual`. It prints
// one JSON object and exits 1 at the first thing that is not so.
'use strict'
const fs = require('fs')
const path = require('path')
const { createRequire } = require('module')

const WAIT = 5000 // ms for an answer
const [generation, port, way, jpeg, rounds] = process.argv.slice(2)
const io = createRequire(path.join(process.cwd(), 'package.json'))(`socket.io-client${generation}`) // run.py installs it there

const fail = (why) => { console.error(why); process.exit(1) }
const options = { reconnection: false, ...(way === 'upgrade' ? {} : { transports: [way] }) } // by default it polls and upgrades
const socket = io(`http://127.0.0.1:${port}`, options)
socket.on('connect_error', (error) => fail(`expected to connect, got ${error}`))

const waiting = []
for (const name of ['steer', 'manual']) {
  socket.on(name, (payload) => waiting.length ? waiting.shift()([name, payload]) : fail(`expected no further answer, got ${name}`))
}
const ask = (payload) => new Promise((resolve) => {
  const late = setTimeout(() => fail(`expected an answer within ${WAIT} ms, got none`), WAIT)
  waiting.push((answer) => { clearTimeout(late); resolve(answer) })
  socket.emit('telemetry', payload)
})

socket.on('connect', async () => {
  const image = fs.readFileSync(jpeg).toString('base64')
  const times = []
  for (let i = 0; i < Number(rounds); i++) {
    const began = performance.now()
    const [steer, payload] = await ask({ steering_angle: '0.0000', throttle: '0.0000', speed: '5.0000', image })
    times.push(performance.now() - began)
    if (steer !== 'steer') fail(`expected steer, got ${steer}`)
    for (const field of ['steering_angle', 'throttle']) {
      const value = payload[field]
      if (typeof value !== 'string' || !(Math.abs(Number(value)) <= 1)) fail(`${field}: expected text of -1 to 1, got ${JSON.stringify(value)}`)
    }
    const [manual] = await ask(null)
    if (manual !== 'manual') fail(`expected manual, got ${manual}`)
  }
  const transport = socket.io.engine.transport.name
  const median = times.sort((a, b) => a - b)[times.length >> 1]
  socket.close()
  console.log(JSON.stringify({ transport, rtt_p50_ms: Number(median.toFixed(2)) }))
})
