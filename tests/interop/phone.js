// Pages as a phone shows them: a small touch screen with three pixels to a point, which only Chromium can pretend to be.
'use strict'
const PHONE = { viewport: { width: 390, height: 844 }, deviceScaleFactor: 3, isMobile: true, hasTouch: true }
// Points that a finger hits (WCAG 2.5.8 asks for 24, the makers of phones for 44).
const FINGER = 40

const phone = (browser) => browser.newContext(PHONE)

// What a finger would miss, and what is cut off: nothing of either.
const missed = (page) => page.evaluate((finger) => {
  const boxes = (of) => [...document.querySelectorAll(of)].filter((node) => node.offsetParent).map((node) => [node, node.getBoundingClientRect()])
  const words = (node) => `${node.tagName} ${node.id || node.textContent.trim().slice(0, 30)}`
  return [
    ...boxes('button, select, input, summary, td a, a.button').filter(([, { width, height }]) => Math.min(width, height) < finger).map(([node, { width, height }]) => `${words(node)}: ${width.toFixed()} x ${height.toFixed()}`),
    ...boxes('main, section, table, td, th, p, h2, h3, select, button, canvas, figure').filter(([node, { right }]) => !node.closest('.frames') && right > innerWidth + 0.5).map(([node]) => `${words(node)}: cut off`),
  ]
}, FINGER)

module.exports = { phone, missed }
