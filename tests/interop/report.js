// The pages of `lapwing score --html` and of `lapwing suite` in a real browser: one cursor, zoom, runs over one another,
// sorting, links to runs, and nothing that is cut off at 400 pixels.
//
//     node report.js REPORT SUITE FILM SHOTS
//
// REPORT shows two runs of one track, SUITE has a failed cell, FILM is an MP4. It prints one JSON object, leaves
// screenshots in the folder SHOTS, and exits 1 at the first thing that is not so.
'use strict'
const path = require('path')
const { pathToFileURL } = require('url')
const { isFirefox, launch, screenshot, shown } = require('./browser.js')
const { missed, phone } = require('./phone.js')

const [report, suite, film, shots] = process.argv.slice(2)
const complaints = []

const fail = (why) => { throw new Error(why) }
const equal = (what, got, expected) => JSON.stringify(got) === JSON.stringify(expected) || fail(`${what}: expected ${JSON.stringify(expected)}, got ${JSON.stringify(got)}`)
const holds = (what, so) => so || fail(`${what}: it does not`)

// By fingers alone: everything is large enough to tap, and a tap into a curve reads it.
async function byTouch(browser) {
  const context = await phone(browser)
  for (const [name, file] of [['report', report], ['suite', suite]]) {
    const page = await context.newPage()
    page.on('pageerror', (error) => complaints.push(error.stack))
    await page.goto(pathToFileURL(file).href)
    await page.waitForTimeout(400)
    for (const head of await page.locator('summary').all()) await head.tap()
    equal(`what fingers miss of the ${name}`, await missed(page), [])
    await page.screenshot({ path: path.join(shots, `${name}-touch.png`), fullPage: true })
    if (name === 'report') {
      const curve = page.locator('.u-over').nth(2)
      await curve.tap()
      await page.waitForTimeout(150)
      holds('a tap reads the curve', /: A [\d.]+ mph, B [\d.]+ mph/.test(await page.locator('.chart .readout').nth(2).innerText()))
    }
  }
  await context.close()
}

async function main() {
  const browser = await launch(['--allow-file-access-from-files'])
  const open = async (file, width, colorScheme) => {
    const page = await browser.newPage({ viewport: { width, height: 900 }, colorScheme })
    page.on('console', (message) => ['error', 'warning'].includes(message.type()) && complaints.push(message.text()))
    page.on('pageerror', (error) => complaints.push(error.stack || error.message))
    page.on('request', (request) => /^(file|data|blob):/.test(request.url()) || complaints.push(`asks elsewhere: ${request.url()}`))
    await page.goto(pathToFileURL(file).href)
    await page.waitForTimeout(400) // charts are drawn in frames of their own
    return page
  }
  // Nothing is wider than the page, nor than what it lies in.
  const cut = (page) => page.evaluate(() => {
    const wide = [...document.querySelectorAll('main, section, table, td, th, p, h2, h3, select, canvas, figure')]
      .filter((node) => !node.closest('.frames') && node.getBoundingClientRect().right > document.documentElement.clientWidth + 0.5)
    return [document.documentElement.scrollWidth - document.documentElement.clientWidth, ...wide.slice(0, 3).map((node) => `${node.tagName} ${node.textContent.slice(0, 40)}`)]
  })
  const shot = (page, name) => screenshot(page, { path: path.join(shots, name + '.png'), fullPage: true }, complaints)
  const dark = (page) => page.evaluate(() => [...document.querySelectorAll('body, main, section, select')].every((node) => {
    const [r, g, b] = getComputedStyle(node).backgroundColor.match(/[\d.]+/g).map(Number)
    return node.tagName === 'MAIN' || r + g + b < 200
  }) && getComputedStyle(document.documentElement).colorScheme === 'dark')
  const result = {}

  for (const [width, scheme] of [[1280, 'light'], [400, 'dark']]) {
    const page = await open(report, width, scheme), at = `at ${width}`
    equal(`report ${at}: pixels too wide, and what is cut`, await cut(page), [0])
    if (shown(scheme) === 'dark') holds('report: all is dark, the drop-downs too', await dark(page))
    // What is looked at first stands first.
    const order = await page.$$eval('h2', (heads) => heads.map((head) => head.textContent.replace(/^[A-Z]?.*\.mcap.*/, 'run')))
    equal(`headings ${at}`, order.map((words) => words.replace(/^.*: 2 runs/, '2 runs')), ['Summary', '2 runs laid over one another', 'run', 'run', 'All figures, side by side'])
    const section = page.locator('section', { hasText: 'laid over one another' }).last()
    const says = () => section.locator('.chart .readout').allTextContents()
    const times = async () => [...new Set((await says()).map((words) => words.split(': ')[0]))]
    const cars = () => section.locator('.car').evaluateAll((cars) => cars.map((car) => !car.hidden && [car.style.left, car.style.top].join()))
    const cameras = () => section.locator('.cameras img').evaluateAll((images) => images.map((image) => image.src.length + image.src.slice(-200)))
    equal(`charts say nothing before anybody points ${at}`, (await says()).join(''), '')
    const first = await cameras()
    const over = section.locator('.u-over')
    const pointAt = async (chart, share) => {
      await chart.scrollIntoViewIfNeeded()
      const { x, y, width, height } = await chart.boundingBox()
      await page.mouse.move(x + share * width - 3, y + height / 2)
      await page.mouse.move(x + share * width, y + height / 2)
      await page.waitForTimeout(150)
    }
    const speed = over.nth(2)
    await pointAt(speed, 0.6)
    const pointed = await times(), there = await cars()
    equal(`times that the charts of both runs say ${at}`, pointed.length, 1)
    holds(`both runs are read ${at}`, /: A [\d.]+ mph, B [\d.]+ mph/.test((await says())[2]))
    equal(`cars on the map ${at}`, there.filter(Boolean).length, 2)
    holds(`the cameras follow ${at}`, JSON.stringify(await cameras()) !== JSON.stringify(first))
    equal(`cars of other sections ${at}`, await page.locator('#run-A .car').evaluateAll((cars) => cars.map((car) => car.hidden)), [true])
    // The map and the pictures move the cursor, too.
    const car = section.locator('.car').first(), canvas = section.locator('.map canvas')
    const where = await car.evaluate((car) => [parseFloat(car.style.left), parseFloat(car.style.top)])
    await pointAt(speed, 0.1)
    const early = await times()
    holds(`another place, another time ${at}`, early[0] !== pointed[0])
    await canvas.hover({ position: { x: where[0] - 3, y: where[1] } })
    await canvas.hover({ position: { x: where[0], y: where[1] } })
    await page.waitForTimeout(150)
    const byMap = (await times())[0]
    holds(`the map moves the cursor of the charts ${at}: ${byMap} for ${pointed}`, seconds(byMap) !== seconds(early[0]) && Math.abs(seconds(byMap) - seconds(pointed[0])) < 2)
    await pointAt(over.nth(0), 0.3)
    const byPicture = (await times())[0]
    holds(`a picture moves the cursor ${at}`, byPicture !== byMap && (await says())[0].includes('picture of'))
    // Keys, and the zoom. The pointer goes first: were it over a curve while that scrolls into view, its leaving would come after the key.
    const root = section.locator('.uplot').nth(2)
    await page.mouse.move(0, 0)
    await root.focus()
    await page.waitForTimeout(150)
    await page.keyboard.press('Home')
    equal(`the time at Home ${at}`, await times(), ['0:00.0'])
    for (let i = 0; i < 20; i++) await page.keyboard.press('ArrowRight')
    holds(`twenty steps to the right ${at}`, seconds((await times())[0]) > 0.2)
    await pointAt(speed, 0.3)
    const unzoomed = (await times())[0]
    const { x, y, width: wide, height } = await speed.boundingBox()
    await page.mouse.move(x + 0.4 * wide, y + height / 2)
    await page.mouse.down()
    await page.mouse.move(x + 0.6 * wide, y + height / 2, { steps: 4 })
    await page.mouse.up()
    await pointAt(over.nth(4), 0.3) // another chart
    const zoomed = (await times())[0]
    holds(`a drag zooms all charts ${at}: ${unzoomed}, then ${zoomed}`, seconds(zoomed) > seconds(unzoomed))
    if (width === 1280) await shot(page, 'report-zoomed')
    await section.locator('button.whole').click()
    await pointAt(speed, 0.3)
    equal(`the time at that place after the button ${at}`, await times(), [unzoomed])
    const heads = (await page.locator('.summary thead th').allTextContents()).map((label) => label.trim())
    holds(`the summary tells the worst offsets, too ${at}`, ['95th percentile of |cte|', 'largest |cte|'].every((label) => heads.includes(label)))
    // Sorting, by key and by mouse.
    const head = page.locator('.summary thead th').nth(6), rows = () => page.locator('.summary tbody th b').allTextContents()
    const value = () => page.locator('.summary tbody tr').evaluateAll((rows) => rows.map((row) => Number(row.cells[6].dataset.value)))
    await head.locator('button').focus()
    await page.keyboard.press('Enter')
    equal(`mean |cte| sorted ${at}`, [await head.getAttribute('aria-sort'), await value()], ['ascending', [...await value()].sort((a, b) => a - b)])
    const up = await rows()
    await head.locator('button').click()
    equal(`and the other way ${at}`, [await head.getAttribute('aria-sort'), await rows()], ['descending', [...up].reverse()])
    // Folded away, and what a curve is drawn over.
    equal(`zero figures are folded ${at}`, await page.locator('details.folded p').first().isVisible(), false)
    holds(`no row is zero throughout ${at}`, await page.locator('.figures tbody tr').evaluateAll((rows) => rows.every((row) => [...row.cells].slice(1).some((cell) => !/^0(\.0+)?( \S+)?$/.test(cell.textContent)))))
    await page.selectOption('#across', 'distance')
    await page.waitForTimeout(300)
    await pointAt(over.nth(2), 0.5)
    holds(`curves over the distance ${at}`, /^\d+ m$/.test((await times())[0]))
    await page.selectOption('#by', 'cte')
    equal(`report ${at}, at the end: what is cut`, await cut(page), [0])
    await page.mouse.move(0, 0)
    await shot(page, `report-${width}-${scheme}`)
    result.charts = (await says()).length
    await page.close()
  }

  for (const [width, scheme] of [[1280, 'light'], [400, 'dark']]) {
    const page = await open(suite, width, scheme), at = `at ${width}`
    equal(`suite ${at}: pixels too wide, and what is cut`, await cut(page), [0])
    if (shown(scheme) === 'dark') holds('suite: all is dark, the drop-down too', await dark(page))
    const rows = () => page.locator('tbody th').allTextContents()
    const head = page.locator('thead th').nth(1), sorting = () => head.getAttribute('aria-sort')
    const named = ['a network', 'the expert'], nearest = ['the expert', 'a network']
    await page.selectOption('#figure', 'mean_cte_m')
    equal(`pilots as they come ${at}`, await rows(), named)
    await head.locator('button').focus()
    await page.keyboard.press('Enter')
    const values = await page.locator('tbody tr').evaluateAll((rows) => rows.map((row) => Number(row.cells[1].dataset.value)))
    equal(`those nearest to the line first ${at}`, [await sorting(), await rows(), values[0] < values[1]], ['ascending', nearest, true])
    await page.keyboard.press('Enter')
    equal(`those farthest from it first ${at}`, [await sorting(), await rows()], ['descending', named])
    await page.keyboard.press('Enter')
    equal(`and the nearest again ${at}`, await rows(), nearest)
    await page.locator('thead th').first().locator('button').click()
    equal(`pilots by name ${at}`, await rows(), named)
    holds(`figures that are zero come last ${at}`, await page.locator('optgroup option').count() > 0)
    await page.locator('td details summary').first().click()
    const link = page.locator('td a', { hasText: 'report' }).first()
    await shot(page, `suite-${width}-${scheme}`)
    const [run, html] = await Promise.all(['run', 'report'].map((words) => page.locator('td a', { hasText: words }).first().evaluate((a) => a.href)))
    holds(`the run of a failed cell ${at}: ${run}`, require('fs').existsSync(new URL(run)))
    await link.click()
    await page.waitForSelector('h2')
    holds(`its report ${at}: ${html}`, (await page.locator('.tile').count()) === 10 && (await page.locator('.chart').count()) > 3)
    equal(`its report ${at}: what is cut`, await cut(page), [0])
    await page.close()
  }

  if (!isFirefox) await byTouch(browser)

  // A figure of eight, 10 m wide: on the map all of its crossing is road, and what it encloses is not. The places of the run
  // are so far apart that no line is drawn between them; the car shows where on the map they are.
  const page = await open(report, 700, 'light')
  const eight = await page.evaluate(() => {
    const edge = (out) => Array.from({ length: 360 }, (_, degrees) => {
      const a = (degrees * Math.PI) / 180, [dx, dz] = [Math.cos(a), Math.cos(2 * a)], length = Math.hypot(dx, dz)
      return [100 * Math.sin(a) + (out * dz) / length, 50 * Math.sin(2 * a) - (out * dx) / length]
    })
    const places = [[0, 0], [60, 0], [100 * Math.SQRT1_2, 50]], t = [0, 10, 20]
    const drawn = { at: places, t, speed: [9, 9, 9], cte: [null, null, null], events: [] }
    const { part, follow } = map([{ drawn, outline: { left: edge(-5), right: edge(5), start: 90 } }], () => {})
    document.querySelector('main').append(part)
    redraws.at(-1)()
    const [canvas, car] = [part.querySelector('canvas'), part.querySelector('.car')]
    const [crossing, inside, elsewhere] = t.map((at) => { follow(() => at); return [parseFloat(car.style.left), parseFloat(car.style.top)] })
    const scale = (inside[0] - crossing[0]) / 60
    const { data, width } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height)
    const colour = (at) => {
      const [x, y] = at.map((css) => Math.floor(css * devicePixelRatio)), first = 4 * (y * width + x)
      return data.slice(first, first + 4).join()
    }
    const near = [-4, -2, 0, 2, 4].flatMap((x) => [-4, -2, 0, 2, 4].map((z) => [x, z])).filter(([x, z]) => Math.hypot(x, z) <= 4)
    const crossed = new Set(near.map(([x, z]) => colour([crossing[0] + scale * x, crossing[1] - scale * z])))
    part.remove()
    return { road: colour(elsewhere), crossed: [...crossed], inside: colour(inside) }
  })
  equal('colours where a road crosses itself', eight.crossed, [eight.road])
  holds(`what a road encloses is not road: ${JSON.stringify(eight)}`, eight.inside !== eight.road)

  // Of which runs the place is an estimate: the map names them only where it is not so of all.
  const headings = await page.evaluate(() => [[false, false], [true, true], [false, true]].map((estimated) => {
    const shown = estimated.map((on_line, i) => {
      const drawn = { at: [[0, 0], [9, 9]], t: [0, 1], speed: [9, 9], cte: [null, null], events: [], on_line }
      return { mark: 'AB'[i], colour: 'red', drawn }
    })
    return map(shown, () => {}).part.querySelector('h3').textContent
  }))
  const estimate = 'estimated along the road; the place across it is not known'
  equal('headings of maps', headings, ['Map', `Map (${estimate})`, `Map (B: ${estimate})`])

  // A film plays: it says how long it is, and what it shows at two places differs and is no blank.
  result.film = await page.evaluate(async (source) => {
    const video = document.createElement('video')
    video.muted = true
    video.src = source
    await new Promise((done, not) => { video.onloadeddata = done; video.onerror = () => not(new Error(video.error.message)) })
    const canvas = document.createElement('canvas')
    const look = async (t) => {
      video.currentTime = t
      await new Promise((done) => { video.onseeked = done })
      Object.assign(canvas, { width: video.videoWidth, height: video.videoHeight })
      const pen = canvas.getContext('2d', { willReadFrequently: true })
      pen.drawImage(video, 0, 0)
      return [...pen.getImageData(0, 0, canvas.width, canvas.height).data]
    }
    const [a, b] = [await look(0.3 * video.duration), await look(0.8 * video.duration)]
    const shades = new Set(a.map((value) => value >> 4)).size, differ = a.filter((value, i) => Math.abs(value - b[i]) > 24).length / a.length
    return { seconds: video.duration, size: [video.videoWidth, video.videoHeight], shades, differ, picture: canvas.toDataURL('image/png') }
  }, pathToFileURL(film).href)
  require('fs').writeFileSync(path.join(shots, 'film.png'), Buffer.from(result.film.picture.split(',')[1], 'base64'))
  delete result.film.picture
  holds(`the film shows a drive: ${JSON.stringify(result.film)}`, result.film.seconds > 1 && result.film.shades > 8 && result.film.differ > 0.02)

  await browser.close()
  equal('complaints', complaints, [])
  process.stdout.write(JSON.stringify(result) + '\n')
}

const seconds = (words) => words.split(':').reduce((minutes, rest) => 60 * +minutes + +rest, 0)

main().catch((error) => { console.error(error.stack); process.exit(1) })
