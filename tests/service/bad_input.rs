//! Every bad input gets a problem document and a 4xx, at every way in, and the service lives on.

use serde_json::{Value, json};

use crate::script::problem;
use crate::server::{Server, problem_document};

/// A bad body, the status it shall get, and a code that shall stand among its faults.
struct Bad {
    what: &'static str,
    body: Vec<u8>,
    status: u16,
    code: &'static str,
}

fn text(what: &'static str, body: impl Into<Vec<u8>>, status: u16, code: &'static str) -> Bad {
    Bad { what, body: body.into(), status, code }
}

/// The good problem with a change, refused with 422.
fn changed(what: &'static str, code: &'static str, change: impl FnOnce(&mut Value)) -> Bad {
    let mut document = problem("nothing");
    change(&mut document);
    text(what, document.to_string(), 422, code)
}

const MINIMAL_URDF: &str = r#"<robot name="r"><link name="base"/><link name="tip"/>
    <joint name="j" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"#;

fn with_urdf(document: &mut Value, xml: &str) {
    let robots = document["workcell"]["robots"].as_object_mut().unwrap();
    for robot in robots.values_mut() {
        *robot = json!({ "urdf_xml": xml });
    }
}

fn first_object(document: &Value) -> String {
    document["objects"][0]["id"].as_str().unwrap().to_owned()
}

fn bad_inputs() -> Vec<Bad> {
    let whole = problem("nothing").to_string();
    let mut inputs = vec![
        text("empty body", "", 400, "invalid_json"),
        text("truncated JSON", &whole[..whole.len() / 2], 400, "invalid_json"),
        text("200,000 open brackets", "[".repeat(200_000), 400, "invalid_json"),
        text("200,000 nested objects", "{\"a\":".repeat(200_000), 400, "invalid_json"),
        text("a 50 MB body", vec![b' '; 50_000_000], 413, "too_large"),
        text("not UTF-8", vec![0xff, 0xfe, 0x00], 400, "invalid_json"),
        text("NaN", whole.replacen("\"radius\":", "\"radius\":NaN,\"x\":", 1), 400, "invalid_json"),
        text("a number beyond f64", r#"{"schema": 1e999}"#, 422, "not_finite"),
        text("an array", "[]", 422, "wrong_type"),
        changed("an unknown field", "unknown_field", |document| document["colour"] = json!("red")),
        changed("an unknown nested field", "unknown_field", |document| {
            document["workcell"]["arms"][0]["tool"]["colour"] = json!("red");
        }),
        changed("a quaternion of norm 2", "bad_quaternion", |document| {
            document["workcell"]["arms"][0]["base"]["orientation"] = json!({"x": 0, "y": 0, "z": 0, "w": 2});
        }),
        changed("an unknown robot", "unknown_robot", |document| {
            document["workcell"]["arms"][1]["robot"] = json!("iiwa99");
        }),
        changed("broken XML", "bad_urdf", |document| with_urdf(document, "<robot name='x'><link")),
        changed("a DTD", "bad_urdf", |document| {
            let dtd = r#"<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>"#;
            with_urdf(document, &format!("{dtd}{MINIMAL_URDF}"));
        }),
        changed("a path with ..", "unresolved_uri", |document| {
            document["workcell"]["robots"] = json!({"iiwa14": {"urdf": "../../etc/passwd"}});
        }),
        changed("an absolute path", "unresolved_uri", |document| {
            document["workcell"]["robots"] = json!({"iiwa14": {"urdf": "/etc/passwd"}});
        }),
        changed("a URDF without the mount link", "unknown_link", |document| {
            with_urdf(document, MINIMAL_URDF);
        }),
        changed("a negative size", "out_of_range", |document| {
            document["objects"][0]["shape"] =
                json!({"type": "box", "size": {"x": -0.06, "y": 0.06, "z": 0.06}});
        }),
        changed("no arms", "out_of_range", |document| document["workcell"]["arms"] = json!([])),
        changed("objects that overlap", "overlap", |document| {
            let second = document["objects"][1]["id"].as_str().unwrap().to_owned();
            let mut placement = document["initial"][first_object(document)].clone();
            let x = placement["pose"]["position"]["x"].as_f64().unwrap();
            placement["pose"]["position"]["x"] = json!(x + 0.03);
            document["initial"][second] = placement;
        }),
        changed("a home that collides", "initial_collision", |document| {
            let home = document["workcell"]["arms"][0]["home"].as_object_mut().unwrap();
            // Stretched out towards the table, or towards the other arm.
            home.insert("joint_1".to_owned(), json!(std::f64::consts::FRAC_PI_2));
            home.insert("joint_2".to_owned(), json!(1.75));
            home.insert("joint_4".to_owned(), json!(0.0));
        }),
        changed("a goal in the air", "not_resting", |document| {
            let object = first_object(document);
            let z = document["goal"][&object]["pose"]["position"]["z"].as_f64().unwrap();
            document["goal"][&object]["pose"]["position"]["z"] = json!(z + 0.3);
        }),
        changed("10,000 objects", "too_large", |document| {
            let object = document["objects"][0].clone();
            let objects: Vec<Value> = (0..10_000)
                .map(|number| {
                    let mut object = object.clone();
                    object["id"] = json!(format!("object_{number}"));
                    object
                })
                .collect();
            document["objects"] = json!(objects);
        }),
    ];
    inputs.push(changed("no schema", "missing_field", |document| {
        document.as_object_mut().unwrap().remove("schema");
    }));
    inputs
}

/// A goal on a table that no arm reaches.
fn far_goal() -> (String, Value) {
    let mut document = problem("nothing");
    let object = first_object(&document);
    let far = |z: f64| json!({"position": {"x": 40.0, "y": 0.0, "z": z}});
    let cell = &mut document["workcell"];
    cell["obstacles"].as_array_mut().unwrap().push(json!({
        "id": "far_table", "shape": {"type": "box", "size": {"x": 0.6, "y": 0.6, "z": 0.05}}, "pose": far(0.5),
    }));
    cell["surfaces"].as_array_mut().unwrap().push(json!({
        "id": "far_top", "on": "far_table", "pose": far(0.525), "size": {"x": 0.5, "y": 0.5},
    }));
    document["goal"][&object] = json!({ "pose": far(0.555) });
    (object, document)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_bad_input_is_refused_with_a_problem_document() {
    let server = Server::start(1, 8).await;
    for bad in bad_inputs() {
        for path in ["/v1/plan", "/v1/jobs", "/v1/validate"] {
            let reply = server.post(path, bad.body.clone()).await;
            assert_eq!(reply.status(), bad.status, "{} at {path}", bad.what);
            let document = problem_document(reply).await;
            let faults = document["errors"].as_array().unwrap();
            let codes: Vec<&str> = faults.iter().filter_map(|fault| fault["code"].as_str()).collect();
            assert!(codes.contains(&bad.code), "{} at {path}: {document}", bad.what);
        }
    }
    assert_eq!(server.json("/v1/jobs").await["jobs"], json!([]), "a refused problem leaves no job");
    assert_eq!(server.json("/readyz").await["running"], 0);
}

#[tokio::test]
async fn a_goal_out_of_reach_is_refused_by_name() {
    let server = Server::start(1, 8).await;
    let (object, body) = far_goal();
    for path in ["/v1/plan", "/v1/jobs"] {
        let reply = server.post(path, body.to_string()).await;
        assert_eq!(reply.status(), 422);
        let document = problem_document(reply).await;
        assert_eq!(document["code"], "goal_unreachable", "{document}");
        assert_eq!(document["errors"][0]["pointer"], format!("/goal/{object}"), "{document}");
        assert!(document["detail"].as_str().unwrap().contains(&object), "{document}");
    }
}

#[tokio::test]
async fn all_faults_come_at_once() {
    let server = Server::start(1, 8).await;
    let mut body = problem("nothing");
    body["colour"] = json!(1);
    body["workcell"]["arms"][0]["robot"] = json!("iiwa99");
    body["options"]["seed"] = json!("seven");
    let reply = server.post("/v1/jobs", body.to_string()).await;
    let document = problem_document(reply).await;
    let pointers: Vec<&str> =
        document["errors"].as_array().unwrap().iter().filter_map(|fault| fault["pointer"].as_str()).collect();
    for pointer in ["/colour", "/workcell/arms/0/robot", "/options/seed"] {
        assert!(pointers.contains(&pointer), "{pointer} in {document}");
    }
}

#[tokio::test]
async fn media_types_and_parameters_are_checked() {
    let server = Server::start(1, 8).await;
    let post = |path: &str| server.client.post(server.url(path)).body(problem("improve 1").to_string());
    for (request, status, code) in [
        (post("/v1/jobs").header("content-type", "text/plain"), 415, "unsupported_media_type"),
        (post("/v1/jobs").header("content-encoding", "gzip"), 415, "unsupported_media_type"),
        (post("/v1/jobs").header("origin", "http://elsewhere"), 415, "unsupported_media_type"),
        (post("/v1/plan").header("accept", "text/html"), 406, "not_acceptable"),
        (post("/v1/plan?cancel_on_disconnect=perhaps"), 400, "bad_parameter"),
        (post("/v1/plan?colour=red"), 400, "bad_parameter"),
        (server.client.get(server.url("/v1/jobs?limit=many")), 400, "bad_parameter"),
        (server.client.get(server.url("/v1/jobs?before=x")), 400, "bad_parameter"),
        (server.client.get(server.url("/v1/jobs/x")), 404, "not_found"),
        (server.client.get(server.url("/v1/jobs/01890a5d-ac96-774b-bcce-b302099a8057")), 404, "not_found"),
        (server.client.get(server.url("/v1/scenarios/switch/5x5")), 404, "not_found"),
        (server.client.get(server.url("/v1/workcells/%ff")), 400, "bad_parameter"),
        (server.client.get(server.url("/v1/jobs/%ff/solutions/best")), 400, "bad_parameter"),
        (server.client.get(server.url("/v1/scenarios/%ff")), 400, "bad_parameter"),
        (server.client.get(server.url("/v1/scenarios/switch/2x2?colour=red")), 400, "bad_parameter"),
        (server.client.get(server.url("/nowhere")), 404, "not_found"),
        (server.client.get(server.url("/v1/plan")), 405, "method_not_allowed"),
        (server.client.delete(server.url("/v1/scenarios")), 405, "method_not_allowed"),
    ] {
        let reply = request.send().await.unwrap();
        assert_eq!(reply.status(), status, "{code}");
        assert_eq!(problem_document(reply).await["code"], code);
    }
}

/// What browsers let any page send to any address, they do not let it do here.
#[tokio::test]
async fn web_pages_start_nothing_unasked() {
    let server = Server::start(1, 8).await;
    let body = problem("improve 1").to_string();
    let simple =
        ["application/x-www-form-urlencoded", "multipart/form-data; boundary=x", "text/plain;charset=UTF-8"];
    let api = quadrille::service::openapi_document();
    let operations = api["paths"].as_object().unwrap().iter().flat_map(|(path, methods)| {
        methods.as_object().unwrap().iter().map(move |(method, operation)| (path, method, operation))
    });
    let mut refused = 0;
    for (path, method, _) in operations.filter(|(_, _, operation)| operation["requestBody"].is_object()) {
        let url = server.url(&path.replace("{id}", "cell"));
        let send = || server.client.request(method.to_uppercase().parse().unwrap(), &url).body(body.clone());
        let typed = simple.iter().map(|media| send().header("content-type", *media));
        // A page may also send what has no type; its origin is then told by the browser.
        for request in typed.chain([send().header("origin", "null")]) {
            let document = server.refused(request, 415).await;
            assert_eq!(document["code"], "unsupported_media_type", "{method} {path}");
            refused += 1;
        }
    }
    assert_eq!(refused, 5 * 4);
    assert_eq!(server.json("/v1/jobs").await["jobs"], json!([]));
    assert_eq!(server.json("/v1/workcells").await["workcells"], json!([]));
    // Who has been let in, and who is no browser.
    let page = server.client.post(server.url("/v1/validate")).header("origin", "http://elsewhere");
    let allowed = page.header("content-type", "application/json").body(body.clone());
    let untyped = server.client.post(server.url("/v1/validate")).body(body);
    for request in [allowed, untyped] {
        assert_eq!(request.send().await.unwrap().status(), 200);
    }
}
