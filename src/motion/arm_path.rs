//! The shortest free path of one arm, all else at rest: straight where possible, else along its
//! roadmap with lazy edge checks (Lazy PRM*, Hauser 2015), shortcut afterwards. What is ahead is found out once,
//! backwards, and guides the searches after each edge that turns out blocked.

use std::cmp::Ordering;
use std::collections::{BTreeSet, BinaryHeap};

use rand::Rng as _;

use crate::collision::{CollisionWorld, Exemption, Held, Resting, StraightMotion};
use crate::kinematics::Config;
use crate::run::{Control, Rng};
use crate::workcell::ArmId;

use super::roadmap::{KnownEdges, Roadmap, Situation};

/// How often a path through the roadmap may turn out blocked before the search gives up.
const GREATEST_REPAIRS: usize = 80;

/// Roadmap vertices to which the ends of a path are joined.
const CONNECTIONS: usize = 12;

/// Another arm that stands still and must be avoided.
#[derive(Debug, Clone)]
pub(super) struct Avoid {
    /// Which arm.
    pub arm: ArmId,
    /// Where it stands.
    pub q: Config,
    /// What it holds.
    pub held: Option<Held>,
}

/// What a path must be free of.
pub(super) struct Surroundings<'a> {
    pub(super) world: &'a CollisionWorld,
    pub(super) arm: ArmId,
    pub(super) held: Option<&'a Held>,
    pub(super) resting: &'a Resting,
    pub(super) avoid: &'a [Avoid],
}

impl Surroundings<'_> {
    /// Whether the straight edge is certified free.
    pub(super) fn edge_free(&self, from: &[f64], to: &[f64]) -> bool {
        let motion = StraightMotion::new(from, to);
        self.is_clear_of_objects(&motion) && self.clear_of_arms(&motion)
    }

    fn is_clear_of_objects(&self, motion: &StraightMotion) -> bool {
        self.world.static_free(self.arm, motion, self.held, self.resting, Exemption::default())
    }

    fn clear_of_arms(&self, motion: &StraightMotion) -> bool {
        let none = Exemption::default();
        self.avoid.iter().all(|other| {
            let rest = StraightMotion::rest(&other.q);
            self.world.motions_apart(
                (self.arm, motion, self.held, none),
                (other.arm, &rest, other.held.as_ref(), none),
                (0.0, 1.0),
            )
        })
    }
}

/// A free path from `from` to `to`, both ends included, with up to `shortcuts` random shortcuts tried; `None` when the
/// roadmap holds none, or `control` stops the search.
pub(super) fn find_path(
    around: &Surroundings<'_>,
    roadmap: &mut Roadmap,
    (from, to): (&Config, &Config),
    shortcuts: usize,
    control: &Control,
    rng: &mut Rng,
) -> Option<Vec<Config>> {
    if around.edge_free(from, to) {
        return Some(vec![from.clone(), to.clone()]);
    }
    let situation = Situation::new(around.held, around.resting, around.avoid);
    let mut known = roadmap.recall(&situation);
    // What is in the way without the arms is in the way.
    let alone = (!around.avoid.is_empty()).then(|| {
        let alone = Situation::new(around.held, around.resting, &[]);
        let known_alone = roadmap.recall(&alone);
        known.blocked.extend(&known_alone.blocked);
        (alone, known_alone)
    });
    let (alone, mut known_alone) = alone.unzip();
    let path = through_roadmap(around, roadmap, (from, to), (&mut known, known_alone.as_mut()), control);
    roadmap.remember(situation, known);
    if let Some((alone, known)) = alone.zip(known_alone) {
        roadmap.remember(alone, known);
    }
    let path = path?;
    Some(shortcut(around, roadmap, path, shortcuts, rng))
}

/// Lazy A* over the roadmap with both ends joined to their nearest vertices.
fn through_roadmap(
    around: &Surroundings<'_>,
    roadmap: &mut Roadmap,
    (from, to): (&Config, &Config),
    (known, mut known_alone): (&mut KnownEdges, Option<&mut KnownEdges>),
    control: &Control,
) -> Option<Vec<Config>> {
    let count = roadmap.vertices().len();
    let (source, target) = (count, count + 1);
    let mut starts = roadmap.nearest(from, CONNECTIONS);
    let mut goals = roadmap.nearest(to, CONNECTIONS);
    let mut free_ends: BTreeSet<(usize, usize)> = BTreeSet::new();
    let mut routes = Routes::new(roadmap, (from, to), (&starts, &goals), &known.blocked);
    for _ in 0..GREATEST_REPAIRS {
        if control.should_stop() {
            return None;
        }
        let route = routes.shortest(roadmap, (from, to), (&starts, &goals), &known.blocked)?;
        let config = |v: usize| {
            if v == source {
                from.clone()
            } else if v == target {
                to.clone()
            } else {
                roadmap.vertices()[v].clone()
            }
        };
        let points: Vec<Config> = route.iter().map(|(v, _)| config(*v)).collect();
        let mut broken = false;
        // From both ends towards the middle: the ends are where most paths break.
        let last = route.len() - 1;
        let order = (0..last).map(|i| if i % 2 == 0 { i / 2 } else { last - 1 - i / 2 });
        for i in order {
            let (u, v) = (route[i].0, route[i + 1].0);
            match route[i + 1].1 {
                Some(edge) => {
                    broken = !known.is_free(edge, || {
                        let motion = StraightMotion::new(&points[i], &points[i + 1]);
                        let mut check =
                            || roadmap.edge_free(around.world, edge) && around.is_clear_of_objects(&motion);
                        let is_free = match &mut known_alone {
                            Some(known) => known.is_free(edge, check),
                            None => check(),
                        };
                        is_free && around.clear_of_arms(&motion)
                    });
                }
                None => {
                    if free_ends.contains(&(u, v)) {
                        continue;
                    }
                    if around.edge_free(&points[i], &points[i + 1]) {
                        free_ends.insert((u, v));
                    } else {
                        if u == source {
                            starts.retain(|&s| s != v);
                        } else {
                            goals.retain(|&g| g != u);
                        }
                        broken = true;
                    }
                }
            }
            if broken {
                break;
            }
        }
        if !broken {
            return Some(points);
        }
    }
    None
}

#[derive(PartialEq)]
struct Open {
    estimate: f64,
    vertex: usize,
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        other.estimate.total_cmp(&self.estimate).then_with(|| other.vertex.cmp(&self.vertex))
    }
}

/// Shortest routes between the same two configurations, one after the other, each with more edges blocked.
struct Routes {
    /// By vertex: the cost of the way there, where it comes from (with the edge), and whether it is final. The
    /// two configurations come after the roadmap's vertices.
    cost: Vec<f64>,
    parent: Vec<Option<(usize, Option<usize>)>>,
    closed: Vec<bool>,
    /// By vertex, a lower bound on the way to the end, where it was asked for: the length of the shortest way with what
    /// was blocked at first, as far as that was followed backwards.
    rest: Vec<f64>,
    /// No way through another vertex, straight from the beginning to it, is shorter.
    followed: f64,
    open: BinaryHeap<Open>,
}

impl Routes {
    /// Over `roadmap`, between two configurations that are joined to `starts` and `goals`. Ways are followed backwards from
    /// the end (A*) until one has come to the beginning: so all searches know what is ahead of them.
    fn new(
        roadmap: &Roadmap,
        (from, to): (&Config, &Config),
        (starts, goals): (&[usize], &[usize]),
        blocked: &BTreeSet<usize>,
    ) -> Self {
        let vertices = roadmap.vertices();
        let count = vertices.len();
        let mut routes = Self {
            cost: vec![f64::INFINITY; count + 2],
            parent: vec![None; count + 2],
            closed: vec![false; count + 2],
            rest: vec![f64::NAN; count + 2],
            followed: f64::INFINITY,
            open: BinaryHeap::new(),
        };
        let Self { cost, closed, rest, open, .. } = &mut routes;
        let mut arrives = f64::INFINITY;
        let before = |vertex: usize| roadmap.distance(from, &vertices[vertex]);
        for &goal in goals {
            cost[goal] = roadmap.distance(&vertices[goal], to);
            open.push(Open { estimate: cost[goal] + before(goal), vertex: goal });
        }
        while let Some(Open { estimate, vertex }) = open.pop() {
            if estimate >= arrives {
                routes.followed = estimate;
                break;
            }
            if std::mem::replace(&mut closed[vertex], true) {
                continue;
            }
            let after = cost[vertex];
            rest[vertex] = after;
            if starts.contains(&vertex) {
                arrives = arrives.min(estimate);
            }
            for link in roadmap.links(vertex) {
                let (edge, next) = (link.edge as usize, link.next as usize);
                let through = after + link.length;
                if through < cost[next] && !roadmap.known_blocked(edge) && !blocked.contains(&edge) {
                    cost[next] = through;
                    open.push(Open { estimate: through + before(next), vertex: next });
                }
            }
        }
        routes
    }

    /// A* between two configurations that are joined to `starts` and `goals`: vertices with the edge that led to each.
    fn shortest(
        &mut self,
        roadmap: &Roadmap,
        (from, to): (&Config, &Config),
        (starts, goals): (&[usize], &[usize]),
        blocked: &BTreeSet<usize>,
    ) -> Option<Vec<(usize, Option<usize>)>> {
        let vertices = roadmap.vertices();
        let (source, target) = (vertices.len(), vertices.len() + 1);
        self.cost.fill(f64::INFINITY);
        self.closed.fill(false);
        self.open.clear();
        self.rest[target] = 0.0;
        self.cost[source] = 0.0;
        self.open.push(Open { estimate: roadmap.distance(from, to), vertex: source });
        while let Some(Open { vertex, .. }) = self.open.pop() {
            if std::mem::replace(&mut self.closed[vertex], true) {
                continue;
            }
            if vertex == target {
                return self.route(source, target);
            }
            let before = self.cost[vertex];
            let mut relax = |next: usize, length: f64, edge: Option<usize>| {
                let through = before + length;
                let is_blocked = |edge: usize| roadmap.known_blocked(edge) || blocked.contains(&edge);
                if through < self.cost[next] && !edge.is_some_and(is_blocked) {
                    self.cost[next] = through;
                    self.parent[next] = Some((vertex, edge));
                    if self.rest[next].is_nan() {
                        let around = self.followed - roadmap.distance(from, &vertices[next]);
                        self.rest[next] = around.max(roadmap.distance(&vertices[next], to));
                    }
                    if self.rest[next].is_finite() {
                        self.open.push(Open { estimate: through + self.rest[next], vertex: next });
                    }
                }
            };
            if vertex == source {
                for &start in starts {
                    relax(start, roadmap.distance(from, &vertices[start]), None);
                }
                continue;
            }
            for link in roadmap.links(vertex) {
                relax(link.next as usize, link.length, Some(link.edge as usize));
            }
            if goals.contains(&vertex) {
                relax(target, roadmap.distance(&vertices[vertex], to), None);
            }
        }
        None
    }

    /// The way by which the target was reached.
    fn route(&self, source: usize, target: usize) -> Option<Vec<(usize, Option<usize>)>> {
        let mut route = vec![];
        let mut at = target;
        while at != source {
            let (before, edge) = self.parent[at]?;
            route.push((at, edge));
            at = before;
        }
        route.push((source, None));
        route.reverse();
        Some(route)
    }
}

/// Shortens a free path: whole waypoints first, then up to `shortcuts` random pieces.
pub(super) fn shortcut(
    around: &Surroundings<'_>,
    roadmap: &Roadmap,
    mut path: Vec<Config>,
    shortcuts: usize,
    rng: &mut Rng,
) -> Vec<Config> {
    let mut start = 0;
    while start + 2 < path.len() {
        let mut end = path.len() - 1;
        while end > start + 1 {
            if around.edge_free(&path[start], &path[end]) {
                path.drain(start + 1..end);
                break;
            }
            end -= 1;
        }
        start += 1;
    }
    for _ in 0..shortcuts {
        if path.len() < 3 {
            break;
        }
        let pieces = path.len() - 1;
        let i = rng.random_range(0..pieces);
        let j = rng.random_range(0..pieces);
        let (i, j) = (i.min(j), i.max(j));
        if i == j {
            continue;
        }
        let cut = |piece: usize, s: f64| -> Config {
            path[piece].iter().zip(&path[piece + 1]).map(|(a, b)| a + (b - a) * s).collect()
        };
        let (a, b) = (cut(i, rng.random()), cut(j, rng.random()));
        let old = roadmap.distance(&a, &path[i + 1])
            + path[i + 1..=j].windows(2).map(|w| roadmap.distance(&w[0], &w[1])).sum::<f64>()
            + roadmap.distance(&path[j], &b);
        if roadmap.distance(&a, &b) < 0.98 * old && around.edge_free(&a, &b) {
            path.splice(i + 1..=j, [a, b]);
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::first_roadmaps;
    use crate::motion::roadmap::draw;
    use crate::run::Seed;
    use crate::scenario::{Family, generate};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

    /// Between two configurations, joined to roadmap vertices.
    type Ends<'a> = ((&'a Config, &'a Config), (&'a [usize], &'a [usize]));

    /// The length of the shortest route, by looking at all edges until none shortens anything.
    fn shortest_length(roadmap: &Roadmap, (ends, joined): Ends<'_>, blocked: &BTreeSet<usize>) -> f64 {
        let vertices = roadmap.vertices();
        let mut cost = vec![f64::INFINITY; vertices.len()];
        joined.0.iter().for_each(|&start| cost[start] = roadmap.distance(ends.0, &vertices[start]));
        loop {
            let before = cost.clone();
            for vertex in 0..vertices.len() {
                for link in
                    roadmap.links(vertex).iter().filter(|link| !blocked.contains(&(link.edge as usize)))
                {
                    let next = link.next as usize;
                    cost[next] = cost[next].min(cost[vertex] + link.length);
                }
            }
            if cost == before {
                break;
            }
        }
        let last = |&goal: &usize| cost[goal] + roadmap.distance(&vertices[goal], ends.1);
        joined.1.iter().map(last).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn routes_stay_the_shortest_while_edges_and_ends_are_blocked() {
        let document = generate(Family::Switch, 2, 2, 1).unwrap();
        let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        let world = CollisionWorld::new(&problem);
        let (roadmaps, _) = first_roadmaps(&problem.workcell, &world, 1, &Control::unbounded());
        let (roadmap, arm) = (&roadmaps[0], &problem.workcell.arms[0]);
        let mut rng = Seed(6).stream("routes");
        let (mut found, mut none) = (0, 0);
        for _ in 0..30 {
            let (from, to) = (draw(arm, &mut rng), draw(arm, &mut rng));
            let mut starts = roadmap.nearest(&from, CONNECTIONS);
            let mut goals = roadmap.nearest(&to, CONNECTIONS);
            let mut blocked = BTreeSet::new();
            let mut routes = Routes::new(roadmap, (&from, &to), (&starts, &goals), &blocked);
            for _ in 0..40 {
                let ends = ((&from, &to), (&starts[..], &goals[..]));
                let least = shortest_length(roadmap, ends, &blocked);
                let Some(route) = routes.shortest(roadmap, ends.0, ends.1, &blocked) else {
                    assert!(least.is_infinite());
                    none += 1;
                    break;
                };
                let at = |vertex: usize| match roadmap.vertices().get(vertex) {
                    Some(q) => q,
                    None if vertex == roadmap.vertices().len() => &from,
                    None => &to,
                };
                let length: f64 = route.windows(2).map(|w| roadmap.distance(at(w[0].0), at(w[1].0))).sum();
                assert!((length - least).abs() < 1e-9, "{length} is not {least}");
                found += 1;
                // Any part of the route may be the one that is blocked; now and then all ways out of a vertex.
                let part = rng.random_range(1..route.len());
                match route[part].1 {
                    Some(edge) => {
                        blocked.insert(edge);
                        let vertex = route[part].0;
                        if rng.random_bool(0.2) {
                            blocked.extend(roadmap.links(vertex).iter().map(|link| link.edge as usize));
                        }
                    }
                    None if part == 1 => starts.retain(|start| *start != route[1].0),
                    None => goals.retain(|goal| *goal != route[part - 1].0),
                }
            }
        }
        assert!(found > 300 && none > 3, "{found} {none}");
    }

    /// What was found out beside another arm serves alone, and the other way round.
    #[test]
    fn ways_past_an_arm_are_those_found_without_any_memory() {
        let document = generate(Family::Switch, 2, 2, 1).unwrap();
        let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        let world = CollisionWorld::new(&problem);
        let control = Control::unbounded();
        let (roadmaps, _) = first_roadmaps(&problem.workcell, &world, 1, &control);
        let pose = crate::geometry::pose_from_parts([0.5, 0.0, 0.9], [0.0, 0.0, 0.0, 1.0]);
        let resting = [(crate::workcell::ObjectId(0), pose)];
        let resting = world.resting_atoms(&crate::collision::Scene { resting: resting.into() });
        let mut rng = Seed(7).stream("past");
        let mut used = roadmaps[0].clone();
        let (mut ways, mut others) = (0, 0);
        for _ in 0..60 {
            let mut any = |arm: usize| {
                let vertices = roadmaps[arm].vertices();
                vertices[rng.random_range(0..vertices.len())].clone()
            };
            let (from, to) = (any(0), any(0));
            let other = [Avoid { arm: ArmId(1), q: any(1), held: None }];
            for avoid in [&[][..], &other[..]] {
                let around =
                    Surroundings { world: &world, arm: ArmId(0), held: None, resting: &resting, avoid };
                let find = |roadmap: &mut Roadmap| {
                    find_path(&around, roadmap, (&from, &to), 0, &control, &mut Seed(0).stream("none"))
                };
                let (found, fresh) = (find(&mut used), find(&mut roadmaps[0].clone()));
                // With more known beforehand the order of repairs is another, and so may be the way.
                let length =
                    |way: &Vec<Config>| -> f64 { way.windows(2).map(|w| used.distance(&w[0], &w[1])).sum() };
                let (found_length, fresh_length) = (found.as_ref().map(length), fresh.as_ref().map(length));
                assert!(found_length.is_some() || fresh_length.is_none());
                if let (Some(a), Some(b)) = (found_length, fresh_length) {
                    ways += 1;
                    others += usize::from((a - b).abs() > 1e-9);
                }
                let way = found.unwrap_or_default();
                assert!(way.windows(2).all(|w| around.edge_free(&w[0], &w[1])));
            }
            let known = used.recall(&Situation::new(None, &resting, &[]));
            let around =
                Surroundings { world: &world, arm: ArmId(0), held: None, resting: &resting, avoid: &[] };
            for (edges, is_free) in [(&known.free, true), (&known.blocked, false)] {
                for &edge in edges {
                    let [a, b] = used.edge_ends(edge).map(|vertex| &used.vertices()[vertex]);
                    assert_eq!(around.edge_free(a, b), is_free);
                }
            }
            used.remember(Situation::new(None, &resting, &[]), known);
        }
        assert!(ways > 40 && others * 10 < ways, "{ways} {others}");
    }
}
