// The live page in a real browser: values arrive, controls act, runs are played and compared, nothing complains.
//
//     node live.js URL serve|drive|record SHOTS
//
// `serve` is the page of a bridge to which two simulators play, `drive` that of the headless simulator in one process,
// `record` the same where what is driven by hand is kept. It prints one JSON object, leaves screenshots in the folder SHOTS, and exits 1 at the first thing that is not so.
'use strict'
const path = require('path')
const { isFirefox, launch, screenshot } = require('./browser.js')
const { missed, phone } = require('./phone.js')

const [url, mode, shots] = process.argv.slice(2)
const WAIT = 30000
const complaints = []

const fail = (why) => { throw new Error(why) }
const equal = (what, got, expected) => JSON.stringify(got) === JSON.stringify(expected) || fail(`${what}: expected ${JSON.stringify(expected)}, got ${JSON.stringify(got)}`)

// Asks until it is so; the last answer says what was wrong.
async function until(what, found) {
  const end = Date.now() + WAIT
  for (;;) {
    const got = await found()
    if (got) return got
    if (Date.now() > end) fail(`${what}: expected within ${WAIT / 1000} s, got none`)
    await new Promise((resolve) => setTimeout(resolve, 50))
  }
}

async function main() {
  const browser = await launch()
  const page = await browser.newPage({ viewport: { width: 1440, height: 900 }, colorScheme: 'light' })
  const listen = (page) => {
    page.on('console', (message) => ['error', 'warning'].includes(message.type()) && complaints.push(message.text()))
    page.on('pageerror', (error) => complaints.push(error.stack || error.message))
  }
  listen(page)
  page.on('request', (request) => new URL(request.url()).origin !== new URL(url).origin && !request.url().startsWith('data:') && !request.url().startsWith('blob:') && complaints.push(`asks elsewhere: ${request.url()}`))
  const text = (selector) => page.locator(selector).first().innerText()
  const state = async () => (await page.request.get(url + 'api/state')).json()
  // All of them before the page is opened, which shows the last one.
  const drives = await until('drives', async () => { const { drives } = await state(); return drives.length >= (mode === 'serve' ? 2 : 1) && drives })
  await page.goto(url)
  const api = async (id = drives.at(-1).id) => (await page.request.get(`${url}api/drives/${id}`)).json()
  const shot = async (name) => {
    await screenshot(page, { path: path.join(shots, `${mode}-${name}.png`), fullPage: true }, complaints)
    if (await page.locator('#map').isVisible() && (await pixels('map')).shades < 2) fail(`${name}: expected a drawn map, got an empty one`)
  }
  const speed = async () => parseFloat(await text('.dial b'))
  // How the picture's pixels differ: a page that shows none has one colour.
  const pixels = (id = 'camera') => page.evaluate((id) => {
    const canvas = document.getElementById(id), { width, height } = canvas, copy = new OffscreenCanvas(width, height).getContext('2d', { willReadFrequently: true })
    copy.drawImage(canvas, 0, 0)
    const { data } = copy.getImageData(0, 0, width, height), seen = new Set()
    for (let i = 0; i < data.length; i += 4 * 97) seen.add((data[i] >> 4) + ' ' + (data[i + 1] >> 4) + ' ' + (data[i + 2] >> 4))
    return { shades: seen.size, brightness: data.reduce((sum, level) => sum + level, 0) / data.length }
  }, id)
  const shades = async () => (await pixels()).shades
  // A layer over the picture darkens it.
  const brightness = async () => (await pixels()).brightness
  const result = {}
  // A person at the wheel is logged, one who has let go or switched the log off is not.
  const record = async () => {
    const rows = async () => (await api()).status.recorded
    equal('rows before anybody drives', await rows(), 0)
    await page.keyboard.press('h')
    await page.keyboard.down('w')
    await until('rows', async () => (await rows()) > 15)
    await page.keyboard.up('w')
    // A gamepad, as the browser would tell of one: left stick, right trigger.
    await page.evaluate(() => {
      const buttons = Array.from({ length: 17 }, (_, i) => ({ value: i === 7 ? 0.5 : 0, pressed: i === 7 }))
      navigator.getGamepads = () => [{ connected: true, axes: [-0.6, 0, 0, 0], buttons }]
    })
    await until('a gamepad at the wheel', async () => { const { turn } = await api(); return turn.by === 'human' && turn.command[0] < -0.2 && turn.command[1] === 0.5 })
    // The other trigger brakes. A stick within its dead zone does not steer.
    await page.evaluate(() => {
      const buttons = Array.from({ length: 17 }, (_, i) => ({ value: i === 6 ? 0.4 : 0, pressed: i === 6 }))
      navigator.getGamepads = () => [{ connected: true, axes: [0.07, 0, 0, 0], buttons }]
    })
    await until('a gamepad that brakes', async () => { const { turn } = await api(); return turn.by === 'human' && turn.command[0] === 0 && turn.command[1] === -0.4 })
    await page.evaluate(() => { navigator.getGamepads = () => [] })
    await page.click('#record')
    await until('a log that is off', async () => !(await api()).status.recording)
    const off = await rows()
    await page.waitForTimeout(500)
    equal('rows while the log is off', (await rows()) - off, 0)
    await page.click('#record')
    await until('more rows', async () => (await rows()) > off)
    await page.keyboard.press('h')
    await until('the expert again', async () => (await api()).turn.by === 'pilot')
    const kept = await rows()
    await page.waitForTimeout(500)
    equal('rows while the expert drives', (await rows()) - kept, 0)
    await shot('laptop')
    result.rows = kept
  }
  const layers = () => page.evaluate(() => +(document.getElementById('camera').dataset.layers ?? 0))
  // What the network looks at is laid over the picture for as long as it is wanted.
  const looks = async () => {
    const plain = await brightness()
    for (const how of ['visual-back-prop', 'integrated-gradients']) {
      await page.selectOption('#live-looks', how)
      await until(`a layer by ${how}`, async () => (await layers()) > 1)
      await until(`a picture darkened by ${how}`, async () => (await brightness()) < 0.9 * plain)
      await shot(how)
    }
    await page.selectOption('#live-looks', '')
    await until('the picture as it was', async () => Math.abs((await brightness()) - plain) < 0.05 * plain)
  }
  // In the player: another model's steering, a second run, and what the network looks at.
  const compare = async () => {
    const shown = () => page.evaluate(() => sides.map(({ canvas }) => [canvas.dataset.shown ?? '', canvas.dataset.layer ?? '']))
    await page.click('#run-list li:last-child button')
    await until('the first run', async () => page.evaluate(() => player.first?.name === runs.names.at(-1)))
    equal('a pilot that looks at no picture', await page.locator('#against option[value="1"]').isDisabled(), true)
    await page.selectOption('#against', '0')
    await until('the whole comparison', async () => (await page.locator('#against-says').getAttribute('data-done')) === 'done')
    const said = await text('#against-says'), figures = /mean absolute difference ([\d.]+)° \([\d.]+\), correlation ([\d.-]+) · (\d+) frames/.exec(said)
    if (!figures) fail(`what is said of the comparison: ${said}`)
    const [frames, curves] = await page.evaluate(() => [compared.t.length, runCharts.find(({ spec }) => spec.model).plot.series.length - 1])
    equal('frames compared, and lines of the steering', [frames, curves], [+figures[3], 2])
    result.agreement = said
    await page.selectOption('#second', await page.evaluate(() => runs.names.at(-2)))
    await until('the second run', async () => page.evaluate(() => Boolean(player.second)))
    await page.locator('#time').fill('20')
    await until('both pictures of this time', async () => {
      const second = await page.evaluate(() => before(player.second.frames_s, player.first.frames_s[20]))
      return JSON.stringify((await shown()).map(([frame]) => frame)) === JSON.stringify(['20', String(second)])
    })
    equal('rows of marks, and lines of each set of curves', await page.evaluate(() => [document.querySelectorAll('.marks:not([hidden])').length, runCharts.map(({ plot }) => plot.series.length - 1)]), [2, [2, 3, 2]])
    await page.selectOption('#align', 'place')
    // Most of the way of the second, which drove it faster.
    const [apart, times] = await page.evaluate(() => {
      seek(tickOfSecond(0.8 * player.second.along.way.t.at(-1)))
      const times = timesAt(player.ticks[player.index])
      const [a, b] = times.map((t, i) => { const { drawn } = [player.first, player.second][i]; return drawn.at[before(drawn.t, t)] })
      return [Math.hypot(a[0] - b[0], a[1] - b[1]), times]
    })
    if (!(apart < 3 && times[0] > times[1] + 0.1)) fail(`two cars at the same place of the track: expected under 3 m apart, at an earlier time in the faster run, got ${apart} m at ${times} s`)
    result.place = times
    equal('what the curves lie over', /metres from the start line/.test(await text('#run-curves')), true)
    await page.selectOption('#align', 'time')
    await page.click('#play')
    await until('both runs play', async () => { const [[first], [second]] = await shown(); return +first > 5 && +second > 5 })
    await page.click('#play')
    for (const how of ['visual-back-prop', 'integrated-gradients']) {
      await page.selectOption('#looks', how)
      await until(`layers by ${how}`, async () => page.evaluate((how) => sides.every(({ canvas: { dataset }, layer }) => layer?.how === how && dataset.layer === dataset.shown), how))
    }
    await page.locator('#time').fill('25')
    await until('layers of the frames that are shown', async () => { const all = await shown(); return all[0][0] === '25' && all.every(([frame, layer]) => frame === layer) })
    const reached = new Set()
    await page.evaluate(() => document.getElementById('back').focus())
    for (let i = 0; i < 9; i++) { reached.add(await page.evaluate(() => document.activeElement.id)); await page.keyboard.press('Tab') }
    equal('controls of the player that the keyboard does not reach', ['back', 'play', 'forth', 'run-file', 'second', 'align', 'against', 'looks'].filter((id) => !reached.has(id)), [])
  }
  // By fingers alone: everything is large enough to tap, taps act, and the time line is moved.
  const byTouch = async () => {
    const touched = await (await phone(browser)).newPage()
    listen(touched)
    await touched.goto(url)
    await until('a connection of the phone', async () => (await touched.locator('#link').innerText()) === 'connected' && touched.evaluate(() => live.turn !== null))
    await touched.tap('#world summary')
    equal('what fingers miss of the live page', await missed(touched), [])
    await touched.tap('#pause')
    await until('a pause by a tap', async () => (await api()).status.paused)
    await touched.tap('#pause')
    await until('an end of it by another', async () => !(await api()).status.paused)
    await touched.screenshot({ path: path.join(shots, `${mode}-touch.png`), fullPage: true })
    await touched.tap('#to-runs')
    await touched.tap('#run-list li:last-child button')
    await until('the first frame on the phone', async () => touched.evaluate(() => document.getElementById('frame').dataset.shown === '0'))
    const { x, y, width, height } = await touched.locator('#time').boundingBox()
    await touched.touchscreen.tap(x + width / 2, y + height / 2)
    await until('the middle of the run', async () => touched.evaluate(() => { const { value, max } = document.getElementById('time'); return Math.abs(value / max - 0.5) < 0.1 && document.getElementById('frame').dataset.shown === value }))
    equal('what fingers miss of the player', await missed(touched), [])
    await touched.screenshot({ path: path.join(shots, `${mode}-touch-runs.png`), fullPage: true })
    await touched.context().close()
  }
  const finish = async () => {
    equal('complaints in the console', complaints, [])
    await browser.close()
    process.stdout.write(JSON.stringify(result) + '\n')
  }
  equal('connection', await until('a connection', async () => (await text('#link')) === 'connected' && 'connected'), 'connected')
  await until('a speed', async () => (await speed()) > 2)
  await until('a picture', async () => (result.shades = await shades()) > 20)
  await until('a score', async () => /distance/.test(await text('#score')))
  await until('a latency', async () => /answer/.test(await text('#latency')))

  // While nothing drives, the live view is greyed, and the recorded runs are not.
  const opacities = await page.evaluate(() => {
    const seen = (view) => [...new Set([...document.querySelectorAll(`#${view} section`)].map((section) => getComputedStyle(section).opacity))]
    document.body.classList.add('empty')
    const views = [seen('main'), seen('runs')]
    document.body.classList.remove('empty')
    return views
  })
  equal('opacity of live and recorded views while nothing drives', opacities, [['0.55'], ['1']])
  equal('how to connect here', await page.locator('#connect').textContent(), `lapwing simulate --connect ${new URL(url).host}`)

  if (mode === 'record') { await record(); return finish() }

  // Controls act on the car.
  // As a person types: over BiDi, `fill` writes behind what stands there.
  const set = async (mph) => { await page.click('#mph'); await page.keyboard.press('ControlOrMeta+a'); await page.keyboard.type(String(mph)); await page.keyboard.press('Enter'); await page.locator('#mph').blur() }
  await set(14)
  await until('the set speed in the drive', async () => (await api()).status.set_speed_mph === 14)
  await until('14 mph', async () => Math.abs((await speed()) - 14) < 1)
  await page.selectOption('#law', 'quadratic')
  await until('the quadratic law', async () => (await api()).status.speed_law === 'quadratic')
  await page.selectOption('#law', 'pi')
  await page.selectOption('#pilot', '1')
  await until('the other pilot', async () => (await api()).status.pilot === 1)
  if (mode === 'drive') await until('why the expert is not explained', async () => (await page.locator('#live-looks').isDisabled()) && /the expert drives by the road/.test(await text('#live-looks-says')))
  await page.selectOption('#pilot', '0')
  await page.keyboard.press('Escape')
  await until('the emergency stop', async () => (await api()).status.hands === 'stopped')
  await until('a car that stands', async () => (await speed()) < 1)
  // For longer than a car that is stuck would stand.
  await page.waitForTimeout(4000)
  equal('a stopped car that waits', [(await api()).status.phase, (await api()).status.hands, /stuck/.test(await text('#events'))], ['driving', 'stopped', false])
  await page.click('#arm')
  await until('a car that drives again', async () => (await speed()) > 3)
  await page.click('#take-over')
  await until('a pilot that is off', async () => (await api()).status.hands === 'off')
  await page.click('#arm')
  await page.keyboard.press('h')
  await page.keyboard.down('ArrowRight')
  await page.keyboard.down('ArrowUp')
  await until('a person at the wheel', async () => { const { turn } = await api(); return turn.by === 'human' && turn.command[0] > 0.2 && turn.command[1] === 1 })
  await page.keyboard.up('ArrowRight')
  await page.keyboard.up('ArrowUp')
  await page.keyboard.press('h')
  await until('the pilot again', async () => (await api()).turn.by === 'pilot')
  const events = await until('events', async () => { const words = await text('#events'); return /emergency stop/.test(words) && /set speed 14 mph/.test(words) && /took the wheel/.test(words) && words })
  result.events = events.split('\n').length
  // Another page, opened in the middle of the drive, has the curves of the time before, and the trail where the car is told.
  const [opened, late] = [Date.now(), await browser.newPage()]
  listen(late)
  await late.goto(url)
  await until('curves that begin before the page', async () => (await late.evaluate(() => minute.last - minute.t[0])) > 3 + (Date.now() - opened) / 1000)
  if (mode === 'drive') equal('a trail that begins before the page', await late.evaluate(() => chartOf.trail.length > 20), true)
  await late.close()

  if (mode === 'serve') {
    await page.selectOption('#live-looks', 'visual-back-prop')
    await until('layers over the pictures of a connection', async () => (await layers()) > 2)
    await page.selectOption('#live-looks', '')
    equal('a control that a connection lacks', [await page.locator('#pause').isDisabled(), /lapwing drive --page/.test(await page.locator('#pause').getAttribute('title'))], [true, true])
    await page.click('#end-run')
    await until('an ended run', async () => (await api()).status.phase === 'ended')
    await page.click('#start-run')
    await until('another run', async () => { const { status } = await api(); return status.phase === 'driving' && status.run === 2 })
    equal('tabs', await page.locator('#tabs button').count(), 2)
    await page.locator('#tabs button').first().click()
    await until('the other simulator', async () => (await page.locator('#tabs button').first().getAttribute('aria-selected')) === 'true' && (await speed()) > 2)
    await until('where the car is, estimated', async () => /estimated/.test(await text('#place')))
    // As long as it looks, the page keeps up: what it shows is what there is.
    const behind = []
    for (let i = 0; i < 20; i++) {
      const { turn } = await api(drives[0].id), shown = await page.evaluate(() => live.turn.n)
      behind.push(turn.n - shown)
    }
    result.behind = Math.max(...behind)
    if (result.behind > 15) fail(`turns that the page is behind: expected 15 at most, got ${behind}`)
  } else {
    await page.click('#world summary')
    await page.click('#pause')
    await until('a pause', async () => (await api()).status.paused)
    const n = (await api()).turn.n
    await page.waitForTimeout(400)
    equal('turns in a pause', (await api()).turn.n - n, 0)
    await page.click('#step')
    await until('one step', async () => (await api()).turn.n === n + 1)
    await page.waitForTimeout(300)
    equal('turns after one step', (await api()).turn.n - n, 1)
    await looks()
    await page.click('#pause')
    await until('it goes on', async () => (await api()).turn.n > n + 5)
    await page.click('#reset')
    await until('the start', async () => { const { status, turn } = await api(); return status.run === 2 && turn && turn.t < 5 })
    await until('some way', async () => (await api()).turn.t > 4)
    await page.selectOption('#track', 'jungle')
    await page.locator('#weather-rain').fill('0.6')
    await page.selectOption('#scenario', 'ccrs')
    await page.click('#apply')
    await until('the jungle', async () => { const { status, turn } = await api(); return status.track === 'jungle' && status.scenario === 'ccrs' && turn })
    await page.selectOption('#scenario', '')
    await page.click('#apply')
    await until('the jungle alone', async () => { const { status, turn } = await api(); return status.track === 'jungle' && !status.scenario && turn })
    await until('a map of it', async () => /jungle/.test(await text('#course')))
    await until('a place on the map', async () => page.evaluate(() => chartOf.place && chartOf.course.name === 'jungle' && !chartOf.place.off_m))
    await page.waitForTimeout(3000)
    // The first two runs are over: one of them is listed with its score, and played.
    await page.click('#to-runs')
    await until('runs with a score', async () => (await page.locator('#run-list button').count()) >= 2 && /\|cte\| [\d.]+ m mean.*largest.*distance/.test(await text('#run-list li:last-child')))
    await page.locator('#run-list button').last().click()
    const shown = async () => page.evaluate(() => +document.getElementById('frame').dataset.shown)
    await until('a first frame', async () => (await shown()) === 0)
    await page.click('#forth')
    await until('one frame on', async () => (await shown()) === 1)
    await page.locator('#time').fill('20')
    await until('frame 20', async () => (await shown()) === 20)
    await page.locator('#time').press('ArrowLeft')
    await until('one frame back', async () => (await shown()) === 19)
    await page.click('#play')
    await until('a run that plays', async () => (await shown()) > 25)
    await page.click('#play')
    const stop = page.locator('#run-events button', { hasText: 'emergency stop' })
    await stop.click()
    const at = await page.evaluate(() => [player.ticks[player.index], player.first.drawn.events.find(({ kind }) => kind === 'emergency-stop').t])
    if (Math.abs(at[0] - at[1]) > 0.2) fail(`the frame of an event: expected at ${at[1]} s, got ${at[0]} s`)
    const [download] = await Promise.all([page.waitForEvent('download'), page.click('#run-file')])
    result.downloaded = download.suggestedFilename()
    const [report] = await Promise.all([page.waitForEvent('popup'), page.click('#run-report')])
    await until('the report, with pictures', async () => /Speed, mph/.test(await report.locator('body').innerText()) && (await report.locator('.cameras img').count()) === 1)
    await screenshot(report, { path: path.join(shots, `${mode}-report.png`) }, complaints)
    await report.close()
    await compare()
    for (const [name, width, colorScheme] of [['runs', 1440, 'light'], ['runs-dark', 1440, 'dark'], ['runs-phone', 400, 'light'], ['runs-phone-dark', 400, 'dark']]) {
      await page.emulateMedia({ colorScheme })
      await page.setViewportSize({ width, height: 900 })
      await page.waitForTimeout(400)
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth)
      if (wide > 0) fail(`runs at ${width} px: expected no cuts, got ${wide} px beyond the window`)
      await shot(name)
    }
    await page.click('#to-live')
    if (!isFirefox) await byTouch()
  }
  await page.evaluate(() => document.activeElement.blur())
  for (const [name, width, colorScheme] of [['laptop', 1440, 'light'], ['laptop-dark', 1440, 'dark'], ['phone', 400, 'light'], ['phone-dark', 400, 'dark'], ['tablet', 900, 'light']]) {
    await page.emulateMedia({ colorScheme })
    await page.setViewportSize({ width, height: 900 })
    await page.waitForTimeout(500)
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth)
    if (wide > 0) fail(`at ${width} px: expected no cuts, got ${wide} px beyond the window`)
    const cut = await page.evaluate(() => [document.getElementById('tabs'), ...document.querySelectorAll('#tabs button')].map((node) => node.scrollWidth - node.clientWidth))
    if (cut.some((px) => px > 0)) fail(`tabs at ${width} px: expected whole titles, got ${cut} px cut off`)
    await shot(name)
  }
  // The axis of a steering of 12 degrees has more numbers than its zero.
  const numbers = await page.evaluate(async () => {
    const chart = document.querySelectorAll('#curves .chart')[1], written = new Set(), { prototype } = CanvasRenderingContext2D, { fillText } = prototype
    prototype.fillText = function (text, ...at) { if (chart.contains(this.canvas)) written.add(text); return fillText.call(this, text, ...at) }
    minute.steering.fill(12)
    minute.asked.fill(12)
    drawCurves[1]()
    await new Promise((resolve) => setTimeout(resolve))
    prototype.fillText = fillText
    return [...written].filter((text) => /^\D?\d+$/.test(text))
  })
  if (numbers.length < 2) fail(`numbers at the axis of the steering: expected 2 or more, got ${numbers}`)
  // Every control is reached by keyboard alone.
  await page.setViewportSize({ width: 1440, height: 900 })
  const reached = new Set()
  for (let i = 0; i < 60; i++) {
    await page.keyboard.press('Tab')
    reached.add(await page.evaluate(() => document.activeElement.id))
  }
  const wanted = await page.evaluate(() => Object.keys(PARTS).filter((id) => { const node = document.getElementById(id); return !node.disabled && node.offsetParent }))
  equal('controls that the keyboard does not reach', wanted.filter((id) => !reached.has(id)), [])
  await finish()
}

main().then(() => process.exit(0), (error) => { console.error(error.message, complaints); process.exit(1) })
