// Headless Chromium through a pipe: node chromium.js PROGRAM, JSON {url, width, height, steps} from stdin.
// Each step is an expression that the page evaluates, or {from, by}: a drag from the place that the
// expression `from` gives, twenty times by [x, y]. Prints the values of the expressions.
const { spawn } = require("child_process"), fs = require("fs"), os = require("os"), path = require("path");
const { url, width, height, steps } = JSON.parse(fs.readFileSync(0, "utf8"));
const home = fs.mkdtempSync(path.join(os.tmpdir(), "chromium-"));
const options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", `--user-data-dir=${home}`];
const browser = spawn(process.argv[2], options, { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
const [to, from] = browser.stdio.slice(3), waiting = new Map(), happened = new Map();
let rest = "", count = 0;
from.on("data", (part) => {
  const told = (rest + part).split("\0");
  rest = told.pop();
  for (const one of told.map((text) => JSON.parse(text))) {
    waiting.get(one.id)?.(one.result ?? one);
    happened.get(one.method)?.();
  }
});
const send = (method, params = {}, sessionId) => new Promise((done) => {
  waiting.set(++count, done);
  to.write(JSON.stringify({ id: count, method, params, sessionId }) + "\0");
});
(async () => {
  const { targetId } = await send("Target.createTarget", { url: "about:blank" });
  const { sessionId } = await send("Target.attachToTarget", { targetId, flatten: true });
  const call = (method, params) => send(method, params, sessionId);
  const loaded = new Promise((done) => happened.set("Page.loadEventFired", done));
  await call("Page.enable");
  await call("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: 1, mobile: width < 600 });
  await call("Page.navigate", { url });
  await loaded;
  await new Promise((done) => setTimeout(done, 300));
  const evaluate = async (expression) => {
    const { result, exceptionDetails } = await call("Runtime.evaluate", { expression, returnByValue: true });
    return exceptionDetails ? exceptionDetails.exception.description : result.value;
  };
  const found = [];
  for (const step of steps) {
    const at = await evaluate(step.from ?? step);
    if (!step.from) { found.push(at); continue; }
    const mouse = (type, k) => call("Input.dispatchMouseEvent",
      { type, x: at[0] + k * step.by[0], y: at[1] + k * step.by[1], button: "left", buttons: 1, clickCount: 1 });
    await mouse("mousePressed", 0);
    for (let k = 1; k <= 20; k++) await mouse("mouseMoved", k);
    await mouse("mouseReleased", 20);
  }
  console.log(JSON.stringify(found));
  const gone = new Promise((done) => browser.on("exit", done));
  send("Browser.close");
  await gone;
  fs.rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 100 });
})();
