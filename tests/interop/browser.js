// The browser that pages are looked at in, which `run.py --browser` names: Chromium, or Firefox by WebDriver BiDi.
'use strict'
const path = require('path')
const { createRequire } = require('module')
const playwright = createRequire(path.join(process.cwd(), 'package.json'))('playwright-core') // run.py installs it there

const QUIET = ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync']
const { INTEROP_BROWSER: which, INTEROP_BROWSER_PATH: executablePath } = process.env
// BiDi cannot switch between light and dark: Firefox is started as one of them.
const FIREFOX = { firefox: 'light', 'firefox-dark': 'dark' }
const isFirefox = which in FIREFOX

// `flags` are Chromium's, `options` playwright's.
function launch(flags = [], options = {}) {
  if (!isFirefox) return playwright.chromium.launch({ ...options, executablePath, args: [...QUIET, ...flags] })
  const firefoxUserPrefs = { 'layout.css.prefers-color-scheme.content-override': FIREFOX[which] === 'dark' ? 0 : 1 }
  return playwright.firefox.launch({ ...options, channel: 'moz-firefox', executablePath, firefoxUserPrefs })
}

// Whether a page that is asked for in this scheme is light or dark.
const shown = (scheme) => FIREFOX[which] ?? scheme

// For a screenshot, playwright adds a style of its own. In Firefox the page's policy refuses that, which is no complaint
// about the page.
async function screenshot(page, options, complaints) {
  const before = complaints.length
  await page.screenshot(options)
  if (isFirefox) complaints.push(...complaints.splice(before).filter((words) => !words.includes('style-src-elem')))
}

module.exports = { isFirefox, launch, screenshot, shown }
