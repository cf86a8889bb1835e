// The list of recent jobs: asks /v1/jobs (with its ETag, so that an unchanged list costs a 304) and draws cards.
// Everything that came from a client is set as text, never as markup.
"use strict";

const ACTIVE = new Set(["queued", "preparing", "rendering", "assembling", "canceling"]);
const list = document.getElementById("job-list");
const status = document.getElementById("status");
const template = document.getElementById("card");
const cards = new Map(); // job id -> its card

document.getElementById("example").textContent =
  document.getElementById("example").textContent.replaceAll("http://localhost", location.origin);

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text; // an unchanged node is not read out again
}

function describeTime(seconds) {
  if (seconds < 60) return `${Math.ceil(seconds)} s`;
  if (seconds < 3600) return `${Math.ceil(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

function describeRate(raysPerSecond) {
  if (raysPerSecond >= 1e6) return `${(raysPerSecond / 1e6).toFixed(1)} Mrays/s`;
  return `${Math.round(raysPerSecond / 1e3)} krays/s`;
}

function link(parent, href, text, name) {
  const anchor = document.createElement("a");
  anchor.href = href;
  anchor.textContent = text;
  anchor.setAttribute("aria-label", `${text} of ${name}`);
  parent.append(anchor);
}

function showPreview(frame, job, name) {
  // While the job runs, its preview grows; the tag makes the browser ask for it again.
  const source = `${job.links.preview_png}?at=${job.progress.tiles_done}-${job.state}`;
  let image = frame.querySelector("img");
  if (!image) {
    image = document.createElement("img");
    image.loading = "lazy";
    image.width = job.image.width;
    image.height = job.image.height;
    frame.replaceChildren(image);
  }
  const text = `Preview of ${name}`;
  if (image.alt !== text) image.alt = text;
  if (image.getAttribute("src") !== source) image.src = source;
}

function draw(job) {
  let card = cards.get(job.id);
  if (!card) {
    card = template.content.firstElementChild.cloneNode(true);
    cards.set(job.id, card);
  }
  const find = (selector) => card.querySelector(selector);
  const name = job.name || `Job ${job.id}`;
  setText(find("h3"), name);
  const badge = find(".badge");
  badge.dataset.state = job.state;
  setText(badge, job.state);
  const when = new Date(job.created_at).toLocaleString();
  setText(find(".facts"), `${job.image.width} × ${job.image.height}, ${job.samples} samples, ${when}`);

  const active = ACTIVE.has(job.state);
  const progress = job.progress;
  find(".progress").hidden = !active;
  if (active) {
    const bar = find("progress");
    bar.value = progress.fraction;
    bar.setAttribute("aria-label", `Progress of ${name}`);
    let text = progress.tiles_total ? `${progress.tiles_done} / ${progress.tiles_total} tiles` : "waiting";
    if (progress.rays_per_s) text += `, ${describeRate(progress.rays_per_s)}`;
    if (progress.eta_s !== null && progress.eta_s !== undefined) text += `, ${describeTime(progress.eta_s)} left`;
    setText(find(".progress-text"), text);
  }

  const problem = find(".problem");
  problem.hidden = !job.problem;
  if (job.problem) setText(problem, job.problem.detail || job.problem.title || "It failed.");

  if (job.links.preview_png) showPreview(find(".frame"), job, name);
  if (card.dataset.drawn !== job.state) {
    card.dataset.drawn = job.state;
    const links = find(".links");
    links.replaceChildren();
    if (job.links.result_png) link(links, job.links.result_png, "PNG", name);
    if (job.links.result_exr) link(links, job.links.result_exr, "EXR", name);
    if (job.links.report) link(links, job.links.report, "Report", name);
    link(links, job.links.scene, "Scene", name);
    link(links, job.links.self, "Job", name);
  }
  return card;
}

let etag = "";
let timer = 0;
let asking = false;
async function refresh() {
  if (asking) return;
  asking = true;
  clearTimeout(timer);
  const active = await ask().catch(() => {
    etag = "";
    setText(status, "The service does not answer; trying again.");
    return false;
  });
  asking = false;
  timer = setTimeout(refresh, document.hidden ? 10000 : active ? 700 : 3000);
}

let active = 0;
async function ask() {
  const answer = await fetch("/v1/jobs?limit=24", { headers: etag ? { "If-None-Match": etag } : {}, cache: "no-store" });
  if (answer.status === 304) return active > 0;
  if (!answer.ok) throw new Error(String(answer.status));
  const page = await answer.json();
  const ids = new Set(page.jobs.map((job) => job.id));
  for (const [id, card] of cards) if (!ids.has(id)) { card.remove(); cards.delete(id); }
  active = 0;
  page.jobs.forEach((job, index) => {
    const card = draw(job);
    if (list.children[index] !== card) list.insertBefore(card, list.children[index] || null);
    if (ACTIVE.has(job.state)) active += 1;
  });
  const shown = page.jobs.length;
  if (shown === 0) setText(status, "No jobs yet.");
  else setText(status, `${active ? `${active} running, ` : ""}${shown}${page.next_cursor ? " newest" : ""} shown`);
  etag = answer.headers.get("ETag") || "";
  return active > 0;
}

document.addEventListener("visibilitychange", () => { if (!document.hidden) refresh(); });
refresh();
