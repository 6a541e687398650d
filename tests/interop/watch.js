// Looks at a drive until it is killed: as a reader that keeps up, as one that reads nothing, in Chromium, or as a reader that
// also asks what the network looks at, as often as the page does.
//
//     node watch.js URL read|stall|chromium|visual-back-prop|integrated-gradients
//
// Prints `ready` once it looks, and how many moments came (or layers, where it asks for them) when it is ended with SIGTERM.
'use strict'
const path = require('path')
const { createRequire } = require('module')
const { launch } = require('./browser.js')
const installed = createRequire(path.join(process.cwd(), 'package.json')) // beside_page.py installs it there
const [url, how] = process.argv.slice(2)
let moments = 0
process.on('SIGTERM', () => { console.log(moments); process.exit(0) })

if (how === 'chromium') {
  launch([], { handleSIGTERM: false }).then(async (browser) => {
    const page = await browser.newPage()
    page.on('websocket', (socket) => socket.on('framereceived', ({ payload }) => { moments += typeof payload === 'string' && payload.includes('"moment"') }))
    await page.goto(url)
    console.log('ready')
  })
} else if (how.includes('-')) {
  // As the page does: 250 ms after the last one.
  const next = async () => {
    const { drives } = await (await fetch(url + 'api/state')).json()
    const layer = drives.length && (await fetch(`${url}api/drives/${drives.at(-1).id}/explained/${how}`))
    if (layer && layer.ok) { await layer.arrayBuffer(); moments++ }
    setTimeout(next, 250)
  }
  next()
  console.log('ready')
} else {
  const WebSocket = installed('ws') // which socket.io-client brings along
  const socket = new WebSocket(url.replace('http', 'ws') + 'live')
  socket.on('open', () => {
    console.log('ready')
    if (how === 'stall') socket._socket.pause()
  })
  socket.on('message', (data, isBinary) => {
    if (isBinary) return
    const message = JSON.parse(data)
    if (message.kind !== 'moment') return
    moments++
    socket.send(JSON.stringify({ seen: message.message }))
  })
}
