// The page that `lapwing score --html` writes, opened in jsdom: its scripts run, and its charts answer mouse and keys.
//
//     node page.js PAGE
//
// jsdom neither lays out nor draws, so that places on the page are zero and a canvas takes every call and shows nothing:
// what is looked at are the elements and what they say. It prints one JSON object and exits 1 at the first thing that is
// not so.
'use strict'
const fs = require('fs')
const path = require('path')
const { createRequire } = require('module')
const { JSDOM, VirtualConsole } = createRequire(path.join(process.cwd(), 'package.json'))('jsdom') // run.py installs it there

const fail = (why) => { console.error(why); process.exit(1) }
const equal = (what, got, expected) => {
  if (JSON.stringify(got) !== JSON.stringify(expected)) fail(`${what}: expected ${JSON.stringify(expected)}, got ${JSON.stringify(got)}`)
}
const turn = () => new Promise((resolve) => setTimeout(resolve, 50)) // frames and microtasks of uPlot

const anything = new Proxy(function () {}, { get: (_, name) => (name === Symbol.toPrimitive ? () => 0 : anything), set: () => true, apply: () => anything })
const onColours = [] // called when the system goes dark or light
const beforeParse = (window) => {
  window.HTMLCanvasElement.prototype.getContext = () => anything
  window.Path2D = function () { return anything }
  window.matchMedia = () => ({ addEventListener: (_, told) => onColours.push(told), removeEventListener() {} })
  window.ResizeObserver = class { constructor(told) { this.told = told } observe() { setTimeout(() => this.told([{ contentRect: { width: 600 } }])) } }
  Object.defineProperty(window.HTMLElement.prototype, 'clientWidth', { get: () => 532 })
}

async function main() {
  const console = new VirtualConsole()
  console.on('jsdomError', (error) => fail(`a script of the page threw ${error.detail?.stack ?? error.stack ?? error}`))
  console.on('error', (...words) => fail(`the page complains: ${words.join(' ')}`))
  const text = fs.readFileSync(process.argv[2], 'utf8')
  const { window } = new JSDOM(text, { runScripts: 'dangerously', pretendToBeVisual: true, virtualConsole: console, beforeParse })
  const { document } = window, all = (selector) => [...document.querySelectorAll(selector)]
  await turn()
  const [run, ...others] = all('section:not(.wide)')
  const charts = [...run.querySelectorAll('.chart')].map((chart) => ({
    title: chart.querySelector('h3').textContent,
    root: chart.querySelector('.uplot'),
    over: chart.querySelector('.u-over'),
    says: () => chart.querySelector('.readout').textContent,
  }))
  const overTime = charts.filter(({ title }) => !title.includes('share')), first = charts[0]
  const says = () => overTime.map((chart) => chart.says())
  const times = () => [...new Set(says().map((words) => words.split(': ')[0]))]
  const seconds = () => times()[0].split(':').reduce((minutes, rest) => 60 * +minutes + +rest)
  const mouse = async (target, type, clientX) => {
    const event = new window.MouseEvent(type, { clientX, clientY: 40, bubbles: true, view: window })
    Object.defineProperty(event, 'movementX', { value: 1 }) // uPlot passes over a move that moves nothing
    target.dispatchEvent(event)
    await turn()
  }
  const press = async (key) => { first.root.dispatchEvent(new window.KeyboardEvent('keydown', { key, bubbles: true })); await turn() }

  equal('what the charts say before anybody points', says().join(''), '')
  await mouse(first.over, 'mouseenter', 100)
  await mouse(first.over, 'mousemove', 100)
  equal('charts that say the time under the cursor', [says().filter((words) => / \S/.test(words)).length, times().length], [overTime.length, 1])
  equal('runs whose map shows the car', all('.car').map((car) => !car.hidden), [true, ...others.map(() => false)])
  equal('what the charts of other runs say', others.map((other) => [...other.querySelectorAll('.chart .readout')].map((one) => one.textContent).join('')).join(''), '')
  const unzoomed = seconds()
  await mouse(first.over, 'mousedown', 200)
  await mouse(first.over, 'mousemove', 300)
  await mouse(document, 'mouseup', 300)
  await mouse(first.over, 'mousemove', 100)
  const zoomed = seconds()
  if (!(zoomed > unzoomed)) fail(`the time at a place before and after zooming into what is right of it: ${unzoomed}, ${zoomed}`)
  equal('times of the charts, zoomed', times().length, 1)
  await mouse(first.over, 'dblclick', 100)
  await mouse(first.over, 'mousemove', 101)
  await mouse(first.over, 'mousemove', 100)
  equal('the time at that place after a double click', seconds(), unzoomed)
  await press('Home')
  equal('the time at Home', times(), ['0:00.0'])
  for (let i = 0; i < 20; i++) await press('ArrowRight')
  if (!(seconds() > 0.2)) fail(`twenty steps to the right of 0:00.0: expected later, got ${seconds()} s`)
  equal('what a screen reader is told', first.root.getAttribute('aria-valuetext'), first.says())
  document.getElementById('by').value = 'cte'
  document.getElementById('by').dispatchEvent(new window.Event('change'))
  for (const told of onColours) told()
  await turn()
  process.stdout.write(JSON.stringify({ charts: charts.map(({ title }) => title), zoomed, unzoomed }) + '\n')
  process.exit(0)
}

main().catch((error) => fail(error.stack))
