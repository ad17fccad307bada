//! Forms: bodies and queries, URL-encoded or plain. Known clients send both without declaring which, so the
//! encoding is detected from the text.

use super::Form;

/// Most fields of one form; further ones are dropped.
const FIELDS_MAX: usize = 1024;

/// The fields of a form.
pub(super) fn decode(body: &[u8]) -> Form {
    if is_encoded(body) {
        let fields = form_urlencoded::parse(body).take(FIELDS_MAX);
        fields
            .map(|(k, v)| (k.into_owned(), v.into_owned()))
            .collect()
    } else {
        plain(&String::from_utf8_lossy(body))
    }
}

/// Whether the text contains no character that URL encoding replaces. Every net and list contains a brace, bracket,
/// angle, quotation mark or blank, and encoders leave none of them.
fn is_encoded(body: &[u8]) -> bool {
    body.iter()
        .all(|b| b.is_ascii_graphic() && !br#"{}[]<>""#.contains(b))
}

/// The name of a device in a plain form. The known client leaves lists and maps of the same form as they are.
fn name(value: &str) -> String {
    let mut decoded = form_urlencoded::parse(value.as_bytes());
    decoded.next().map_or_else(String::new, |(key, rest)| {
        // An `=` in the name ends the key.
        if rest.is_empty() {
            key.into_owned()
        } else {
            format!("{key}={rest}")
        }
    })
}

/// The fields of a plain form, without any escapes besides those of a device name. A part without a key belongs to the value before it, such as
/// the `&lt;` of XML.
fn plain(body: &str) -> Form {
    let mut fields: Form = Vec::new();
    for part in body.split('&') {
        let field = part.split_once('=').filter(|(key, _)| is_key(key));
        if let Some((key, value)) = field.filter(|_| fields.len() < FIELDS_MAX) {
            let value = if key == "name" {
                name(value)
            } else {
                value.to_owned()
            };
            fields.push((key.to_owned(), value));
        } else if let Some((_, value)) = fields.last_mut() {
            value.push('&');
            value.push_str(part);
        }
    }
    fields
}

fn is_key(key: &str) -> bool {
    let belongs = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
    !key.is_empty() && key.bytes().all(belongs)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(body: &str) -> Vec<(String, String)> {
        decode(body.as_bytes())
    }

    fn pair(key: &str, value: &str) -> (String, String) {
        (key.to_owned(), value.to_owned())
    }

    #[test]
    fn encoded_and_plain_forms_are_distinguished() {
        let net = "{a=B(P='1e+3 %41&b'),outX=a.y}";
        let encoded: String = form_urlencoded::byte_serialize(net.as_bytes()).collect();
        let expected = [pair("dionet", net), pair("desc", "a b")];
        assert_eq!(fields(&format!("dionet={encoded}&desc=a+b")), expected);
        assert_eq!(fields(&format!("dionet={net}&desc=a b")), expected);
        // Scripts leave some marks as they are.
        let script = "dionet=%7Ba%3DB(P%3D'1')%7D";
        assert_eq!(fields(script), [pair("dionet", "{a=B(P='1')}")]);
    }

    #[test]
    fn known_client_device_form_is_decoded() {
        let body =
            "name=lwr1&type=kuka_lwr_sim&com={pos:{x:0.0,y:0.0,z:0.0}}&min_joint=[-2.9,1.0E-4]";
        let expected = [
            pair("name", "lwr1"),
            pair("type", "kuka_lwr_sim"),
            pair("com", "{pos:{x:0.0,y:0.0,z:0.0}}"),
            pair("min_joint", "[-2.9,1.0E-4]"),
        ];
        assert_eq!(fields(body), expected);
    }

    #[test]
    fn device_name_of_plain_form_is_decoded() {
        for (sent, name) in [
            ("Test+device%27s", "Test device's"),
            ("a b", "a b"),
            ("a=b", "a=b"),
            ("", ""),
        ] {
            let body = format!("name={sent}&min_joint=[-2.9]");
            let expected = [pair("name", name), pair("min_joint", "[-2.9]")];
            assert_eq!(fields(&body), expected);
        }
    }

    #[test]
    fn plain_xml_entities_stay_in_value() {
        let body = r#"rpinet=<rpinet a="&lt;=&amp;"/>&desc=x"#;
        let expected = [
            pair("rpinet", r#"<rpinet a="&lt;=&amp;"/>"#),
            pair("desc", "x"),
        ];
        assert_eq!(fields(body), expected);
        assert_eq!(fields("&&=[&"), []);
    }

    #[test]
    fn fields_are_bounded() {
        assert_eq!(fields(&"a=1&".repeat(100_000)).len(), FIELDS_MAX);
        assert_eq!(fields(&"a=[&".repeat(100_000)).len(), FIELDS_MAX);
    }
}
