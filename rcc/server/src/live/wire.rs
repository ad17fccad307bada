//! Messages of the Foxglove WebSocket protocol, version 1: JSON in text frames, and binary frames that begin with an opcode;
//! numbers are little-endian. It keeps no state.
//!
//! | from the server | bytes |
//! |---|---|
//! | message | u8 1, u32 subscription, u64 time in ns, payload |
//! | response of a service | u8 3, u32 service, u32 call, u32 length of the encoding, encoding, payload |
//!
//! | from the client | bytes |
//! |---|---|
//! | request of a service | u8 2, u32 service, u32 call, u32 length of the encoding, encoding, payload |

use serde_json::{Value, json};

/// Subprotocols that are spoken; of what is used here they differ in their name only.
pub(crate) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Most characters of a name or identifier of a client that is repeated to it.
const ECHO_CHARS_MAX: usize = 256;

/// A request of a client.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Request {
    /// Pairs of subscription and channel.
    Subscribe(Vec<(u32, u32)>),
    /// Subscriptions.
    Unsubscribe(Vec<u32>),
    /// Names, none for all, and the identifier to be repeated.
    GetParameters(Vec<String>, Option<String>),
    /// Names, and the identifier to be repeated.
    SetParameters(Vec<String>, Option<String>),
    /// A call of a service.
    Call(Call),
    /// Something that needs no answer.
    Ignored,
    /// Something that this server does not offer: a text for the client.
    Unknown(String),
}

/// A call of a service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Call {
    pub(crate) service: u32,
    pub(crate) call: u32,
    pub(crate) encoding: String,
    pub(crate) payload: Vec<u8>,
}

/// Reads a message of a client; text and binary messages differ in their first byte.
pub(crate) fn decode(message: &[u8]) -> Request {
    match message.split_first() {
        Some((2, rest)) => decode_call(rest).map_or_else(
            || Request::Unknown("the request of a service is too short".to_owned()),
            Request::Call,
        ),
        Some((opcode @ (0 | 1 | 3..=8), _)) => Request::Unknown(format!(
            "binary messages of opcode {opcode} are not offered"
        )),
        _ => match serde_json::from_slice(message) {
            Ok(value) => decode_text(&value),
            Err(error) => Request::Unknown(format!("a message is no JSON: {error}")),
        },
    }
}

fn decode_call(bytes: &[u8]) -> Option<Call> {
    let (service, rest) = bytes.split_first_chunk()?;
    let (call, rest) = rest.split_first_chunk()?;
    let (length, rest) = rest.split_first_chunk()?;
    let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
    let (encoding, payload) = rest.split_at_checked(length)?;
    Some(Call {
        service: u32::from_le_bytes(*service),
        call: u32::from_le_bytes(*call),
        encoding: String::from_utf8_lossy(encoding).into_owned(),
        payload: payload.to_vec(),
    })
}

fn decode_text(value: &Value) -> Request {
    let list = |key: &str| {
        value
            .get(key)
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
    };
    let number = |value: &Value| value.as_u64().and_then(|n| u32::try_from(n).ok());
    let cut = |text: &str| text.chars().take(ECHO_CHARS_MAX).collect::<String>();
    let id = || value.get("id").and_then(Value::as_str).map(cut);
    let op = value.get("op").and_then(Value::as_str).unwrap_or_default();
    match op {
        "subscribe" => {
            let pair = |it: &Value| Some((number(it.get("id")?)?, number(it.get("channelId")?)?));
            Request::Subscribe(list("subscriptions").filter_map(pair).collect())
        }
        "unsubscribe" => Request::Unsubscribe(list("subscriptionIds").filter_map(number).collect()),
        "getParameters" => {
            let names = list("parameterNames").filter_map(Value::as_str);
            Request::GetParameters(names.map(cut).collect(), id())
        }
        "setParameters" => {
            let names = list("parameters").filter_map(|it| it.get("name")?.as_str());
            Request::SetParameters(names.map(cut).collect(), id())
        }
        "subscribeParameterUpdates"
        | "unsubscribeParameterUpdates"
        | "unsubscribeConnectionGraph" => Request::Ignored,
        _ => Request::Unknown(format!("the operation `{}` is not offered", cut(op))),
    }
}

/// The first message: who this is, and what it offers.
pub(crate) fn server_info(services: bool, session: &str) -> Value {
    let mut capabilities = vec!["parameters", "parametersSubscribe"];
    if services {
        capabilities.push("services");
    }
    json!({"op": "serverInfo", "name": "takt", "capabilities": capabilities,
        "supportedEncodings": ["json"], "metadata": {"version": env!("CARGO_PKG_VERSION")},
        "sessionId": session})
}

/// A channel of a topic.
pub(crate) fn channel(id: u32, topic: &str, schema: &str, text: &str) -> Value {
    json!({"id": id, "topic": topic, "encoding": "cdr", "schemaName": schema,
        "schemaEncoding": "ros2msg", "schema": text})
}

/// Announces channels.
pub(crate) fn advertise(channels: &[&Value]) -> Value {
    json!({"op": "advertise", "channels": channels})
}

/// Announces the end of channels.
pub(crate) fn unadvertise(channels: &[u32]) -> Value {
    json!({"op": "unadvertise", "channelIds": channels})
}

/// Severity of a status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Warning = 1,
    Error = 2,
}

/// A text for the person at the client; a further one of the same identifier replaces it.
pub(crate) fn status(level: Level, text: &str, id: &str) -> Value {
    json!({"op": "status", "level": level as u8, "message": text, "id": id})
}

/// Values of parameters.
pub(crate) fn parameter_values(values: &[Value], id: Option<&str>) -> Value {
    let mut message = json!({"op": "parameterValues", "parameters": values});
    if let (Some(id), Some(message)) = (id, message.as_object_mut()) {
        message.insert("id".to_owned(), id.into());
    }
    message
}

/// A call failed.
pub(crate) fn call_failure(service: u32, call: u32, text: &str) -> Value {
    json!({"op": "serviceCallFailure", "serviceId": service, "callId": call, "message": text})
}

/// A call succeeded.
pub(crate) fn call_response(service: u32, call: u32, payload: &Value) -> Vec<u8> {
    const ENCODING: &str = "json";
    let mut bytes = vec![3];
    bytes.extend(service.to_le_bytes());
    bytes.extend(call.to_le_bytes());
    bytes.extend(u32::try_from(ENCODING.len()).unwrap_or(0).to_le_bytes());
    bytes.extend(ENCODING.bytes());
    bytes.extend(payload.to_string().bytes());
    bytes
}

/// Appends the payload of a binary frame with a message.
pub(crate) fn message(subscription: u32, time: u64, data: &[u8], out: &mut Vec<u8>) {
    out.push(1);
    out.extend(subscription.to_le_bytes());
    out.extend(time.to_le_bytes());
    out.extend_from_slice(data);
}

/// Feeds any bytes to the reader of messages, and checks what it accepts.
///
/// # Panics
/// If an answer would be longer than what a client may cause, or no JSON.
#[doc(hidden)]
pub fn fuzz(data: &[u8]) {
    let bound = |text: &str| assert!(text.len() <= 2 * 4 * ECHO_CHARS_MAX, "{text}");
    match decode(data) {
        Request::Subscribe(pairs) => assert!(pairs.len() <= data.len() / 4),
        Request::Unsubscribe(numbers) => assert!(numbers.len() <= data.len()),
        Request::GetParameters(names, id) | Request::SetParameters(names, id) => {
            names.iter().chain(&id).for_each(|text| bound(text));
            let answer = parameter_values(&[], id.as_deref()).to_string();
            assert!(serde_json::from_str::<Value>(&answer).is_ok(), "{answer}");
        }
        Request::Call(call) => {
            // A byte that is no UTF-8 becomes a character of three.
            assert!(call.encoding.len() <= 3 * data.len());
            let response = call_response(call.service, call.call, &json!({"ok": true}));
            assert_eq!(data.get(1..9), response.get(1..9), "numbers are repeated");
        }
        Request::Unknown(text) => bound(&text),
        Request::Ignored => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foxglove_message_is_as_published() {
        let mut bytes = Vec::new();
        message(30, 1234, b"{}", &mut bytes);
        let head = [1, 30, 0, 0, 0, 0xd2, 4, 0, 0, 0, 0, 0, 0];
        assert_eq!(bytes, [&head[..], b"{}"].concat());
        let bytes = call_response(1, 2, &json!({}));
        let head = [3, 1, 0, 0, 0, 2, 0, 0, 0, 4, 0, 0, 0];
        assert_eq!(bytes, [&head[..], b"json{}"].concat());
    }

    #[test]
    fn foxglove_request_of_client_is_decoded() {
        let text = |text: &str| decode(text.as_bytes());
        let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":10},{"id":2}]}"#;
        assert_eq!(text(subscribe), Request::Subscribe(vec![(1, 10)]));
        let unsubscribe = r#"{"op":"unsubscribe","subscriptionIds":[1,-2,99999999999]}"#;
        assert_eq!(text(unsubscribe), Request::Unsubscribe(vec![1]));
        let get = r#"{"op":"getParameters","parameterNames":["a"],"id":"x"}"#;
        let (names, id) = (vec!["a".to_owned()], Some("x".to_owned()));
        assert_eq!(text(get), Request::GetParameters(names, id));
        let mut call = vec![2, 1, 0, 0, 0, 7, 0, 0, 0, 4, 0, 0, 0];
        call.extend(b"json{}");
        let wanted = Call {
            service: 1,
            call: 7,
            encoding: "json".to_owned(),
            payload: b"{}".to_vec(),
        };
        assert_eq!(decode(&call), Request::Call(wanted));
        for length in 1..17 {
            assert!(matches!(decode(&call[..length]), Request::Unknown(_)));
        }
        for wrong in [
            "",
            "{",
            "[]",
            "7",
            "{\"op\":7}",
            "{\"op\":\"fetchAsset\"}",
            "\u{1}abc",
        ] {
            assert!(matches!(text(wrong), Request::Unknown(_)), "{wrong:?}");
        }
    }
}
