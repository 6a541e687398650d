// Pictures of the live page and of a report, one each FRAME_MS, for moving_picture.py.
//
//     node moving_picture.js PAGE REPORT FOLDER FRAME_MS
'use strict'
const path = require('path')
const { pathToFileURL } = require('url')
const { createRequire } = require('module')
const { chromium } = createRequire(path.join(process.cwd(), 'package.json'))('playwright-core')

const [live, report, folder, frameMs] = process.argv.slice(2)
const VIEW = { width: 1200, height: 675 }
// Wide enough for the map and a curve at once.
const REPORT_VIEW = { width: 1500, height: 844 }
// The page's curves show the last minute; after this long, in milliseconds, there is something on them.
const WARM_MS = 20000
const PAGE_FRAMES = 24
const REPORT_FRAMES = 34

async function main() {
  const browser = await chromium.launch({ executablePath: process.env.INTEROP_BROWSER_PATH, args: ['--no-sandbox', '--disable-gpu'] })
  const page = await browser.newPage({ viewport: VIEW, colorScheme: 'light' })
  const shot = (name, i) => page.screenshot({ path: path.join(folder, `${name}-${String(i).padStart(3, '0')}.png`) })
  await page.goto(live)
  await page.waitForTimeout(WARM_MS)
  const began = Date.now()
  for (let i = 0; i < PAGE_FRAMES; i++) {
    await shot('page', i)
    await page.waitForTimeout(Math.max(0, began + (i + 1) * Number(frameMs) - Date.now()))
  }
  await page.setViewportSize(REPORT_VIEW)
  await page.goto(pathToFileURL(report).href)
  await page.waitForTimeout(500)
  const chart = page.locator('.u-over').nth(1)
  const { x, y: top, width, height: tall } = await chart.boundingBox(), down = top + tall + 50 - REPORT_VIEW.height
  for (let i = 0; i < REPORT_FRAMES; i++) {
    // The scorecard and the map first; then down to the curves, and along them.
    const along = Math.max(0, i - 10) / (REPORT_FRAMES - 11)
    await page.evaluate((top) => scrollTo(0, top), Math.min(1, Math.max(0, i - 4) / 6) * down)
    if (i > 10) {
      const { y, height } = await chart.boundingBox()
      await page.mouse.move(x + (0.1 + 0.7 * along) * width, y + height / 2)
    }
    await page.waitForTimeout(60)
    await shot('report', i)
  }
  // The same report as a picture that stands still.
  await page.setViewportSize({ width: 1000, height: 1330 })
  await page.mouse.move(0, 0)
  await page.evaluate(() => scrollTo(0, 0))
  await page.waitForTimeout(500)
  await page.screenshot({ path: path.join(folder, 'scorecard.png') })
  await browser.close()
}

main().catch((error) => { console.error(error.stack); process.exit(1) })
