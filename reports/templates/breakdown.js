// Means by subject, pose, camera or light, and frames by score or by the difference of two methods.
{
  const data = JSON.parse(document.getElementById("scores-data").textContent);
  const place = document.getElementById("breakdown");
  const fields = Object.assign({}, ...[...place.querySelectorAll("select")].map((one) => ({ [one.name]: one })));
  const means = place.querySelector(".means");
  const frames = place.querySelector(".frames");
  const every = place.querySelector(".every");
  const SOME = 12;
  const PARTS = ["subject", "pose", "camera", "light"];
  const BY = { subject: "subject", light: "light", kind: "kind of light", pose: "pose", camera: "camera" };
  let all = false;

  const fill = (field, options) => field.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
  const metric = () => data.metrics[fields.metric.selectedIndex];
  const text = (value, sign = false) => {
    if (value === null || Number.isNaN(value)) return "–";
    const digits = value.toFixed(metric().decimals);
    return (sign && Number(digits) > 0 ? "+" : "") + (Number(digits) === 0 ? digits.replace("-", "") : digits.replace("-", "−"));
  };
  const better = (a, b) => (metric().higher ? b - a : a - b); // sorts the better one first
  // The frames of the chosen column: [query, kind, value of each row].
  function chosen() {
    const m = fields.metric.selectedIndex;
    const seen = new Map();
    for (const column of data.columns) {
      if (fields.column.value && column.name !== fields.column.value) continue;
      column.frames.forEach((frame, i) => seen.set(frame, column.values.map((row) => row[m][i])));
    }
    return [...seen].map(([frame, values]) => [...data.frames[frame], values]);
  }
  const part = (query, kind, by) => (by === "kind" ? data.kinds[kind] ?? kind : query.split("/")[PARTS.indexOf(by)]);
  function cells(line, texts, head = "th") {
    line.replaceChildren(...texts.map((each, i) => {
      const cell = document.createElement(i ? (head === "th" && line.parentElement.tagName === "THEAD" ? "th" : "td") : "th");
      if (cell.tagName === "TH") cell.scope = line.parentElement.tagName === "THEAD" ? "col" : "row";
      if (i) cell.className = "num";
      cell.append(each);
      return cell;
    }));
  }
  function showMeans(found) {
    const groups = new Map();
    for (const [query, kind, values] of found) {
      const name = part(query, kind, fields.by.value);
      groups.set(name, [...(groups.get(name) ?? []), values]);
    }
    const names = [...groups.keys()].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
    means.caption.textContent = `${metric().title} ${metric().higher ? "↑" : "↓"} by ${BY[fields.by.value]}, ${fields.column.selectedOptions[0].text.toLowerCase()}`;
    cells(means.tHead.rows[0], [BY[fields.by.value], "n", ...data.rows.map((row) => row.title)]);
    means.tBodies[0].replaceChildren(...names.map((name) => {
      const lines = groups.get(name);
      const line = document.createElement("tr");
      means.tBodies[0].append(line);
      const mean = (row) => {
        const there = lines.map((values) => values[row]).filter((value) => value !== null);
        return there.length ? there.reduce((sum, value) => sum + value, 0) / there.length : null;
      };
      cells(line, [name, String(lines.length), ...data.rows.map((_, row) => text(mean(row)))]);
      return line;
    }));
  }
  function showFrames(found) {
    const mine = Number(fields.method.value);
    const theirs = fields.beside.value === "" ? null : Number(fields.beside.value);
    const apart = ([, , values]) => (theirs === null || values[mine] === null || values[theirs] === null ? null : values[mine] - values[theirs]);
    const orders = {
      worst: (a, b) => better(b[2][mine], a[2][mine]), best: (a, b) => better(a[2][mine], b[2][mine]),
      loss: (a, b) => better(apart(b), apart(a)), gain: (a, b) => better(apart(a), apart(b)),
    };
    const gap = (each) => (["loss", "gain"].includes(fields.order.value) ? apart(each) : each[2][mine]) === null;
    const sorted = [...found].sort((a, b) => gap(a) - gap(b) || orders[fields.order.value](a, b) || a[0].localeCompare(b[0], "en", { numeric: true }));
    const shown = all ? sorted : sorted.slice(0, SOME);
    frames.caption.textContent = `${shown.length} of ${found.length} frames by ${metric().title}, ${fields.order.selectedOptions[0].text}`;
    const titles = [data.rows[mine].title, ...(theirs === null ? [] : [data.rows[theirs].title, "difference"])];
    cells(frames.tHead.rows[0], ["Frame", ...titles]);
    frames.tBodies[0].replaceChildren(...shown.map((each) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = each[0];
      button.addEventListener("click", () => viewerShow?.(each[0], data.rows[mine].title, theirs === null ? null : data.rows[theirs].title));
      const line = document.createElement("tr");
      frames.tBodies[0].append(line);
      cells(line, [viewerShow ? button : each[0], text(each[2][mine]), ...(theirs === null ? [] : [text(each[2][theirs]), text(apart(each), true)])]);
      return line;
    }));
    every.hidden = found.length <= SOME;
    every.textContent = all ? `Show ${SOME} frames` : `Show all ${found.length} frames`;
  }
  function show() {
    for (const option of fields.order.options) option.disabled = fields.beside.value === "" && ["loss", "gain"].includes(option.value);
    if (fields.order.selectedOptions[0]?.disabled ?? true) fields.order.value = "worst";
    const found = chosen();
    showMeans(found);
    showFrames(found);
    cues();
  }
  fill(fields.metric, data.metrics.map((each) => [each.name, each.title]));
  fill(fields.column, [["", "All columns"], ...data.columns.map((each) => [each.name, each.title])]);
  fill(fields.by, Object.entries(BY));
  const methods = data.rows.map((row, i) => [String(i), row.title]);
  fill(fields.method, methods);
  fill(fields.beside, [["", "none"], ...methods]);
  fields.method.value = String(data.best);
  const KEPT = { metric: "of", column: "within", by: "by", method: "method", beside: "beside", order: "order" };
  for (const [name, key] of Object.entries(KEPT)) {
    const kept = state.get(key);
    const row = ["method", "beside"].includes(name) ? data.rows.findIndex((each) => each.name === kept) : kept;
    if (kept !== null && row !== -1 && [...fields[name].options].some((option) => option.value === String(row))) fields[name].value = String(row);
    fields[name].addEventListener("change", () => {
      const value = fields[name].value;
      state.set({ [key]: ["method", "beside"].includes(name) && value !== "" ? data.rows[value].name : value });
      show();
    });
  }
  every.addEventListener("click", () => { all = !all; show(); });
  for (const hidden of place.querySelectorAll("[hidden]")) hidden.hidden = false;
  show();
}
