// What the live page does while telemetry comes 60 times a second, beside the same page with nothing on it.
//
//     node jank.js URL SECONDS
//
// Prints `ready` once it has looked at the idle page for SECONDS: now a drive should begin, at 60 telemetries a second, that
// lasts at least 8 s longer. Once that is over it looks at the idle page again, and prints one JSON object: what it counted
// before, during and after the drive, and around a while in which the page did not listen. checks_live.py judges it.
'use strict'
const { launch } = require('./browser.js')

const [url, seconds] = [process.argv[2], +process.argv[3]]
const WAIT = 120000
const fail = (why) => { throw new Error(why) }

async function until(what, found) {
  const end = Date.now() + WAIT
  while (!(await found())) {
    if (Date.now() > end) fail(`${what}: expected within ${WAIT / 1000} s, got none`)
    await new Promise((resolve) => setTimeout(resolve, 50))
  }
}

// In the page: counts of what comes, of what is drawn, of frames of the screen and of long tasks.
function count() {
  window.counts = { frames: 0, long: 0, moments: 0, pictures: 0, decoded: 0, draws: 0, twice: 0, old: 0, decoding: 0, together: 0 }
  window.newest = null
  let drawn = false
  const frame = () => { counts.frames++; drawn = false; requestAnimationFrame(frame) }
  requestAnimationFrame(frame)
  new PerformanceObserver((list) => { counts.long += list.getEntries().length }).observe({ type: 'longtask' })
  const { moment } = HEARD
  HEARD.moment = (message) => { counts.moments++; if (message.turn) newest = message.turn.n; moment(message) }
  const picture = showPicture
  showPicture = (bytes) => { counts.pictures++; return picture(bytes) }
  const decode = createImageBitmap
  createImageBitmap = async (...of) => {
    counts.decoded++
    counts.together = Math.max(counts.together, ++counts.decoding)
    try { return await decode(...of) } finally { counts.decoding-- }
  }
  const draw = drawCamera
  drawCamera = (turn) => {
    counts.draws++
    if (drawn) counts.twice++
    if (turn && turn.n !== newest) counts.old++
    drawn = true
    return draw(turn)
  }
}

async function main() {
  const browser = await launch()
  const page = await browser.newPage({ viewport: { width: 1440, height: 900 } })
  const complaints = []
  page.on('console', (message) => ['error', 'warning'].includes(message.type()) && complaints.push(message.text()))
  page.on('pageerror', (error) => complaints.push(error.stack || error.message))
  await page.goto(url)
  await until('a connection', () => page.evaluate(() => document.getElementById('link').innerText === 'connected'))
  await page.evaluate(count)
  // The time that the page's own thread works, of which another program's work is no part.
  const devtools = await page.context().newCDPSession(page)
  await devtools.send('Performance.enable', { timeDomain: 'threadTicks' })
  const worked = async () => (await devtools.send('Performance.getMetrics')).metrics.find(({ name }) => name === 'TaskDuration').value
  const turns = () => page.evaluate(() => live.turn?.n ?? 0)
  // What was counted within this time.
  const look = async () => {
    const [before, n, busy] = [await page.evaluate(() => ({ ...counts, at: performance.now() })), await turns(), await worked()]
    await page.waitForTimeout(1000 * seconds)
    const [after, m, later] = [await page.evaluate(() => ({ ...counts, at: performance.now() })), await turns(), await worked()]
    const seen = Object.fromEntries(Object.keys(after).map((key) => [key, after[key] - before[key]]))
    return { ...seen, together: after.together, turns: m - n, passed: seen.at / 1000, busy: later - busy }
  }
  const before = await look()
  console.log('ready')
  await until('a drive', async () => (await turns()) > 60)
  const driven = await look()
  // The page is busy with something else for thirty turns. Of these it gets few: two were on their way, then the newest.
  const stalled = await page.evaluate(async (ms) => {
    const [n, moments, began] = [newest, counts.moments, performance.now()]
    while (performance.now() - began < ms);
    await new Promise((resolve) => { const wait = () => (counts.moments - moments > 2 ? resolve() : setTimeout(wait)); wait() })
    return { moments: counts.moments - moments, turns: newest - n }
  }, 30 * 1000 * driven.passed / driven.turns)
  await until('the end of the drive', () => page.evaluate(() => live.drives.length === 0))
  await new Promise((resolve) => setTimeout(resolve, 500))
  const after = await look()
  await browser.close()
  if (complaints.length) fail(`complaints in the console: ${complaints}`)
  process.stdout.write(JSON.stringify({ before, driven, stalled, after }) + '\n')
}

main().then(() => process.exit(0), (error) => { console.error(error.message); process.exit(1) })
