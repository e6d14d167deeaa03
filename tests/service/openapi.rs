//! The interface as it is written down: the files in `api/`, the schemas, the examples.
//!
//! `QUADRILLE_WRITE_API=1 cargo test --release --test service openapi` writes the files anew.

use std::fs;
use std::path::PathBuf;

use quadrille::wire::{LibraryOnly, ReadLimits, read_problem_value};
use serde_json::{Value, json};

use crate::schema::faults;
use crate::script::problem;
use crate::server::Server;

fn api(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("api").join(name)
}

/// Asserts that a file holds `document`, or writes it there when that is asked for.
fn holds(name: &str, document: &Value) {
    let path = api(name);
    let text = serde_json::to_string_pretty(document).unwrap() + "\n";
    if std::env::var_os("QUADRILLE_WRITE_API").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, &text).unwrap();
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    assert!(found == text, "api/{name} is not what the code says; write it anew with QUADRILLE_WRITE_API=1");
}

#[tokio::test]
async fn the_files_are_what_the_code_says() {
    let server = Server::start(1, 8).await;
    let served = server.json("/openapi.json").await;
    assert_eq!(served, quadrille::service::openapi_document());
    holds("openapi.json", &served);
    for (name, schema) in quadrille::service::json_schemas() {
        holds(&format!("schemas/{name}"), &schema);
    }
}

/// The schema of a reply.
fn schema_of<'a>(api: &'a Value, path: &str, method: &str, status: u16, media: &str) -> &'a Value {
    let reply = &api["paths"][path][method]["responses"][status.to_string()];
    let reply = match reply["$ref"].as_str() {
        Some(reference) => api.pointer(reference.trim_start_matches('#')).unwrap(),
        None => reply,
    };
    let schema = &reply["content"][media]["schema"];
    assert!(schema.is_object(), "{method} {path} says nothing of {status} {media}");
    schema
}

#[test]
fn scenarios_fit_the_schema_and_mistakes_do_not() {
    let api = quadrille::service::openapi_document();
    let schema = json!({ "$ref": "#/components/schemas/Problem" });
    for entry in quadrille::scenario::catalog() {
        let document: Value = serde_json::from_str(entry.text).unwrap();
        assert_eq!(faults(&api, &schema, &document), Vec::<String>::new(), "{}", entry.name);
    }
    let good = problem("x");
    for (pointer, value) in [
        ("/schema", json!("quadrille.problem/2")),
        ("/workcell/arms/0/base", json!(1)),
        ("/workcell/arms/0/tool/colour", json!("red")),
        ("/objects/0/shape", json!({"type": "box"})),
        ("/options/guidance", json!("clever")),
        ("/colour", json!("red")),
    ] {
        let mut bad = good.clone();
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        bad.pointer_mut(parent).unwrap()[key] = value;
        assert!(!faults(&api, &schema, &bad).is_empty(), "{pointer}");
    }
}

/// What the schema lets through is read, and what it does not is refused.
#[test]
fn the_schema_and_the_reader_agree() {
    let api = quadrille::service::openapi_document();
    let schema = json!({ "$ref": "#/components/schemas/Problem" });
    for (pointer, value, is_good) in [
        ("/objects/0/grasps", json!([{"id": "side", "object_in_tcp": {}}]), true),
        ("/objects/0/grasps", json!([{"object_in_tcp": {}}]), false),
        ("/objects/0/grasps", json!([{"id": 1, "object_in_tcp": {}}]), false),
        ("/objects/0/grasps", json!({"generator": "top", "yaw_steps": 4, "depth": 0.02}), true),
        ("/objects/0/grasps", json!({"generator": "box_edges", "depth": 0.02}), true),
        ("/objects/0/grasps", json!([{"generator": "box_faces", "yaw_steps": 4}]), false),
        ("/objects/0/grasps", json!([{"generator": "box_edges", "yaw_steps": 4}]), false),
        ("/objects/0/grasps", json!([{"generator": "teeth"}]), false),
        ("/workcell/arms/0/tool/max_opening", json!(0.05), true),
        ("/workcell/arms/0/tool/max_opening", json!(0), false),
        ("/workcell/surfaces/0/capacity", json!(4), true),
        ("/workcell/surfaces/0/capacity", json!(null), true),
        ("/workcell/surfaces/0/capacity", json!(-1), false),
    ] {
        let mut document = problem("x");
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        document.pointer_mut(parent).unwrap()[key] = value.clone();
        let found = faults(&api, &schema, &document);
        assert_eq!(found.is_empty(), is_good, "{pointer} {value}: {found:?}");
        let read = read_problem_value(&document, &LibraryOnly, &ReadLimits::default());
        assert_eq!(read.is_ok(), is_good, "{pointer} {value}: {:?}", read.err());
    }
    // The checker knows no patterns but that of digests.
    let id = "/components/schemas/Object/properties/id/pattern";
    let grasp = api.pointer("/components/schemas/Grasp/anyOf/2/properties/id/pattern");
    assert!(grasp.is_some() && grasp == api.pointer(id));
}

/// Whether `found` has all that `wanted` has; `"..."` stands for anything.
fn has(found: &Value, wanted: &Value) -> bool {
    match (found, wanted) {
        (_, Value::String(any)) if any == "..." => true,
        (Value::Object(found), Value::Object(wanted)) => {
            wanted.iter().all(|(key, value)| found.get(key).is_some_and(|own| has(own, value)))
        }
        (Value::Array(found), Value::Array(wanted)) => {
            found.len() == wanted.len() && found.iter().zip(wanted).all(|(own, value)| has(own, value))
        }
        _ => found == wanted,
    }
}

/// Replaces `{"$scenario": name}` by that problem, `{"$workcell": name}` by its workcell, and
/// `{"$reply": pointer}` by what the reply before has there.
fn expanded(value: &Value, before: &Value) -> Value {
    let document = |name: &Value| -> Value {
        serde_json::from_str(quadrille::scenario::find(name.as_str().unwrap()).unwrap().text).unwrap()
    };
    match value {
        Value::Object(map) if map.contains_key("$scenario") => {
            let mut whole = document(&map["$scenario"]);
            let others = map.iter().filter(|(key, _)| !key.starts_with('$'));
            others.for_each(|(key, value)| whole[key] = expanded(value, before));
            whole
        }
        Value::Object(map) if map.contains_key("$workcell") => document(&map["$workcell"])["workcell"].take(),
        Value::Object(map) if map.contains_key("$reply") => {
            before.pointer(map["$reply"].as_str().unwrap()).unwrap().clone()
        }
        Value::Object(map) => map.iter().map(|(key, value)| (key.clone(), expanded(value, before))).collect(),
        other => other.clone(),
    }
}

/// Each file below `api/examples` is a conversation: requests and replies in order, where `{job}` in a
/// path is the job of the last `Location`.
#[tokio::test]
async fn examples_do_what_they_say() {
    let api_document = quadrille::service::openapi_document();
    let mut names: Vec<PathBuf> =
        fs::read_dir(api("examples")).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.retain(|path| path.extension().is_some_and(|ending| ending == "json"));
    names.sort();
    assert!(names.len() >= 8);
    for name in names {
        let server = Server::start(1, 8).await;
        let example: Value = serde_json::from_str(&fs::read_to_string(&name).unwrap()).unwrap();
        let (mut job, mut before) = (String::new(), Value::Null);
        for exchange in example["exchanges"].as_array().unwrap() {
            let request = &exchange["request"];
            let (method, template) = (request["method"].as_str().unwrap(), request["path"].as_str().unwrap());
            let path = template.replace("{job}", &job);
            let mut sent = server.client.request(method.parse().unwrap(), server.url(&path));
            for (header, value) in request["headers"].as_object().into_iter().flatten() {
                sent = sent.header(header, value.as_str().unwrap());
            }
            if let Some(body) = request.get("body") {
                let body = body.as_str().map_or_else(|| expanded(body, &before).to_string(), str::to_owned);
                sent = sent.header("content-type", "application/json").body(body);
            }
            let reply = sent.send().await.unwrap();
            let wanted = &exchange["reply"];
            let status = reply.status().as_u16();
            let location = reply.headers().get("location");
            if let Some(location) = location {
                job = location.to_str().unwrap().rsplit('/').next().unwrap().to_owned();
            }
            let route = exchange["route"].as_str().unwrap();
            let method = method.to_lowercase();
            let described = &api_document["paths"][route][&method]["responses"][status.to_string()];
            assert_eq!(location.is_some(), described["headers"]["Location"].is_object(), "{method} {path}");
            let media = reply.headers().get("content-type").map(|kind| kind.to_str().unwrap().to_owned());
            let text = reply.text().await.unwrap();
            assert_eq!(status, wanted["status"], "{}: {path}: {text}", name.display());
            match media.as_deref() {
                None => assert!(text.is_empty()),
                Some("application/x-ndjson") => {
                    let schema = schema_of(&api_document, route, &method, status, "application/x-ndjson");
                    let events: Vec<Value> =
                        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
                    for event in &events {
                        assert_eq!(faults(&api_document, schema, event), Vec::<String>::new());
                    }
                    let durable: Value =
                        events.into_iter().filter(|event| event["type"] != "progress").collect();
                    assert!(has(&durable, &wanted["events"]), "{}: {durable}", name.display());
                }
                Some(media) => {
                    let schema = schema_of(&api_document, route, &method, status, media);
                    let body: Value = serde_json::from_str(&text).unwrap();
                    assert_eq!(faults(&api_document, schema, &body), Vec::<String>::new(), "{path}");
                    assert!(has(&body, &wanted["body"]), "{}: {path}: {body}", name.display());
                    before = body;
                }
            }
        }
    }
}

#[tokio::test]
async fn the_page_loads_nothing_from_elsewhere() {
    let server = Server::start(1, 8).await;
    let reply = server.get("/docs").await;
    assert_eq!(reply.headers()["content-type"], "text/html; charset=utf-8");
    assert!(reply.headers()["content-security-policy"].to_str().unwrap().contains("default-src 'none'"));
    let page = reply.text().await.unwrap();
    for reference in ["http://", "https://", "src=", "@import", "url("] {
        assert!(!page.contains(reference), "{reference}");
    }
    assert!(page.contains("fetch(\"/openapi.json\")"));
}
