// A graph whose clusters are written one by one: where they stand, and their factors.

class GraphSource {
  constructor(data, numbers) {
    this.data = data;
    this.numbers = numbers;
    this.run = 0;
    this.height = 40;
    this.clusters = new Map();
    this.ids = [];
    data.clusters.forEach((cluster, k) => {
      const names = cluster.scope.map((v) => data.variables[v].name);
      this.ids.push(cluster.index);
      this.clusters.set(cluster.index, {
        ...cluster,
        place: k,
        id: cluster.index,
        x: data.places.x[k],
        y: data.places.y[k],
        width: data.places.width[k],
        towards: data.places.towards[k],
        names,
        evidence: cluster.observed.length > 0,
        neighbours: [],
      });
    });
    this.edges = data.edges.map((edge, k) => {
      const [i, j] = edge.ends;
      this.clusters.get(i).neighbours.push(j);
      this.clusters.get(j).neighbours.push(i);
      const names = edge.scope.map((v) => data.variables[v].name);
      return { ...edge, place: k, id: `${i}-${j}`, names, label: fittedNames(names, 150, 11) };
    });
    this.byEnds = new Map(this.edges.map((edge) => [edge.id, edge]));
    for (const cluster of this.clusters.values()) cluster.neighbours.sort((a, b) => a - b);
  }

  node(id) {
    return this.clusters.get(id) ?? null;
  }

  // What the colours of clusters tell.
  get changed() {
    return "moved by evidence from the prior";
  }

  // How far evidence moved each variable of a cluster from its prior, in nats, the furthest first.
  moved(id) {
    const { moved } = this.data.runs[this.run];
    const found = this.clusters.get(id).names.map((name) => [name, moved[name] ?? NaN]);
    return found.filter(([, nats]) => !Number.isNaN(nats)).sort(([, a], [, b]) => b - a);
  }

  // The true value of a variable, its components or the index of its state; null of one not given.
  truth(name) {
    return this.data.runs[this.run].truth[name] ?? null;
  }

  neighbours(id) {
    return this.clusters.get(id).neighbours;
  }

  // The neighbours that sent messages to a cluster: of modes there are none.
  senders(id) {
    return this.data.words.messages ? [] : this.neighbours(id);
  }

  bounds() {
    const all = [...this.clusters.values()];
    return {
      left: Math.min(...all.map((c) => c.x - c.width / 2)),
      right: Math.max(...all.map((c) => c.x + c.width / 2)),
      top: Math.min(...all.map((c) => c.y - this.height / 2)),
      bottom: Math.max(...all.map((c) => c.y + this.height / 2)),
    };
  }

  nodesIn(box) {
    return this.ids.filter((id) => {
      const { x, y, width } = this.clusters.get(id);
      return x + width / 2 > box.left && x - width / 2 < box.right
        && y + this.height / 2 > box.top && y - this.height / 2 < box.bottom;
    });
  }

  edgesIn(box) {
    return this.edges.filter(({ ends: [i, j] }) => {
      const a = this.clusters.get(i);
      const b = this.clusters.get(j);
      return Math.max(a.x, b.x) > box.left && Math.min(a.x, b.x) < box.right
        && Math.max(a.y, b.y) > box.top && Math.min(a.y, b.y) < box.bottom;
    });
  }

  edge(i, j) {
    return this.byEnds.get(`${Math.min(i, j)}-${Math.max(i, j)}`) ?? null;
  }

  about(id) {
    const cluster = this.clusters.get(id);
    return {
      variables: cluster.names,
      observed: cluster.observed.map(([name, values]) => {
        const value = values[this.run];
        return value === null ? name : `${name} = ${value}`;
      }),
      cpds: cluster.cpds.map((given) => cpdText(given, null)),
      cut: cluster.cut,
      moved: new Map(this.moved(id)),
      changed: this.changed,
      anew: new Set(cluster.scope.map((v) => this.data.variables[v]).filter((v) => v.anew).map((v) => v.name)),
      role: this.role(cluster),
    };
  }

  // Of a clique of a growing map: the variables that leave there, and those that its parent has too.
  role({ scope, pivots, touched }) {
    if (!pivots) return null;
    const name = (v) => this.data.variables[v].name;
    const separators = scope.filter((v) => !pivots.includes(v)).map(name);
    const given = separators.length ? ` given ${listedNames(separators, 60)}` : "";
    return `eliminates ${listedNames(pivots.map(name), 60)}${given}${touched ? "; touched by the last addition" : ""}`;
  }

  potential(id) {
    const cluster = this.clusters.get(id);
    return this.factor(cluster.potential[this.run], cluster.scope);
  }

  message(i, j) {
    const edge = this.edge(i, j);
    return this.factor((i < j ? edge.there : edge.back)[this.run], edge.scope);
  }

  belief(id) {
    const cluster = this.clusters.get(id);
    const given = cluster.belief[this.run];
    const found = this.factor(given, cluster.scope);
    if (found.type !== "gaussian" || found.why) return found;
    if (cluster.cut.length) {
      found.why = "not computed: neighbours of this cluster are not in this page";
      return found;
    }
    const arrived = cluster.neighbours.map((k) => this.message(k, id));
    found.canonical = gaussianProduct(this.potential(id), arrived);
    if (!found.canonical) found.why = "no canonical form: singular";
    return found;
  }

  // The Gaussians of a mixture over a cluster, by weight.
  gaussians(id) {
    const cluster = this.clusters.get(id);
    const found = cluster.belief[this.run].gaussians ?? [];
    return found.map((given) => {
      const factor = this.factor(given, cluster.scope);
      factor.why = "moments alone: it is one of a mixture's Gaussians";
      return { weight: given.weight, factor };
    });
  }

  factor(given, scope) {
    const variables = (given.scope ?? scope).map((k) => this.data.variables[k]);
    const from = given.at;
    const take = (first, count) => this.numbers.subarray(from + first, from + first + count);
    if (given.form === "none") return none(given.why);
    if (given.form === "table") {
      const count = sizesOf(variables).reduce((a, b) => a * b, 1);
      return table(variables, take(0, count), this.numbers[from + count]);
    }
    if (given.form === "largest") {
      let first = 2 * given.count + 1;
      const marginals = variables.map((variable) => {
        const own = take(first, variable.states.length);
        first += variable.states.length;
        const total = sum(own);
        return total > 0 ? own.map((value) => value / total) : own;
      });
      return {
        type: "largest", variables, entries: given.entries, marginals,
        places: take(0, given.count), values: take(given.count, given.count),
        scale: this.numbers[from + 2 * given.count],
        why: `the ${given.count} largest of ${thousands(given.entries)} entries`,
      };
    }
    const n = variables.reduce((total, variable) => total + variable.components.length, 0);
    const triangle = (n * (n + 1)) / 2;
    if (given.form === "moments") {
      const moments = { mean: take(0, n), cov: fromLower(take(n, triangle), n) };
      const mixture = given.gaussians ? "moments alone: this belief is a mixture of Gaussians" : null;
      return gaussian(variables, { moments, why: given.why ? "no canonical form: singular" : mixture });
    }
    const canonical = {
      K: fromLower(take(0, triangle), n),
      h: take(triangle, n),
      g: this.numbers[from + triangle + n],
    };
    return gaussian(variables, { canonical });
  }

  // The change along each edge: in an iteration, or what is left at the end.
  residuals(iteration) {
    const found = this.data.runs[this.run].edges;
    if (!found) return null;
    if (iteration === null || !found.each) return found.left;
    return [...new Rows(this.numbers, found.each).row(iteration)];
  }

  find(text) {
    const wanted = text.toLowerCase();
    const found = [];
    if (/^c?\d+$/.test(wanted)) {
      const id = Number(wanted.replace("c", ""));
      if (this.clusters.has(id)) found.push({ text: `cluster ${id}`, id });
    }
    const held = new Map();
    for (const cluster of this.clusters.values()) {
      for (const name of cluster.names) {
        const before = held.get(name);
        if (before === undefined || cluster.names.length < this.clusters.get(before).names.length) {
          held.set(name, cluster.id);
        }
      }
    }
    for (const cluster of this.clusters.values()) {
      for (const [name] of cluster.observed) if (!held.has(name)) held.set(name, cluster.id);
    }
    const ranked = [...held].filter(([name]) => name.toLowerCase().includes(wanted));
    ranked.sort(([a], [b]) => a.toLowerCase().indexOf(wanted) - b.toLowerCase().indexOf(wanted)
      || a.length - b.length || (a < b ? -1 : 1));
    return found.concat(ranked.map(([name, id]) => ({ text: `${name}  in cluster ${id}`, id })));
  }
}

// p(x[3] | x[2], u[3]), with the steps of a template put in.
function cpdText(given, step) {
  const placed = ([name, lag]) => (step === null ? name : `${name}[${step - lag}]`);
  const parents = given.given.map(placed).join(", ");
  if (!given.child) return `φ(${parents})  ${given.kind}`;
  return `p(${placed(given.child)}${parents ? ` | ${parents}` : ""})  ${given.kind}`;
}
