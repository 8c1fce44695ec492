local field = {}
local order = {}

local function declare(name, make, title, ...)
    field[name] = make("candes." .. name, title, ...)
    order[#order + 1] = field[name]
end

declare("u", ProtoField.bool, "U: the sender is not in a working mode")
declare("d", ProtoField.bool, "D: for nodes that are not in a working mode")
declare("r", ProtoField.bool, "R: response")
declare("b", ProtoField.bool, "B: broadcast")
declare("err", ProtoField.bool, "ERR: no error")
declare("type", ProtoField.string, "Message type")
declare("src", ProtoField.uint8, "SRC")
declare("src_name", ProtoField.string, "Name of SRC")
declare("dst", ProtoField.uint8, "DST")
declare("dst_name", ProtoField.string, "Name of DST")
declare("srv", ProtoField.uint16, "SRV", base.HEX)
declare("service", ProtoField.string, "Service")
declare("text", ProtoField.string, "Meaning")
declare("field", ProtoField.string, "Field")
declare("field_name", ProtoField.string, "Name")
declare("field_value", ProtoField.string, "Value")
declare("field_number", ProtoField.double, "Number")
declare("field_unit", ProtoField.string, "Unit")
declare("framing", ProtoField.string, "Framing")
declare("isotp.kind", ProtoField.string, "ISO-TP frame")
declare("isotp.length", ProtoField.uint32, "Length of the message")
declare("isotp.sequence", ProtoField.uint8, "Sequence number")
declare("isotp.block_size", ProtoField.uint8, "Block size")
declare("isotp.st_min", ProtoField.uint8, "STmin", base.HEX)
declare("isotp.message", ProtoField.bytes, "Message")
declare("request", ProtoField.uint8, "DES request", base.HEX)
declare("name", ProtoField.string, "Name")
declare("service_index", ProtoField.uint8, "Service")
declare("service_name", ProtoField.string, "Name")
declare("service_version", ProtoField.string, "Version")
declare("service_more", ProtoField.string, "Further string")
declare("fault", ProtoField.string, "Malformed")
declare("uid", ProtoField.string, "UID")
declare("mode", ProtoField.string, "Mode")
declare("error_code", ProtoField.uint8, "Error code")

local candes = Proto("candes", "CAN platform with DES")
candes.fields = order

local malformed = ProtoExpert.new("candes.malformed", "Malformed DES message",
    expert.group.MALFORMED, expert.severity.WARN)
local nonconforming = ProtoExpert.new("candes.nonconforming", "No message type has these flags",
    expert.group.PROTOCOL, expert.severity.WARN)
local failed = ProtoExpert.new("candes.failed", "Error response",
    expert.group.RESPONSE_CODE, expert.severity.NOTE)
candes.experts = { malformed, nonconforming, failed }

local can_id = Field.new("can.id")
local can_extended = Field.new("can.flags.xtd")
local can_remote = Field.new("can.flags.rtr")
local canfd_rate = Field.new("canfd.flags.brs")
local interface = Field.new("frame.interface_id")

-- Text ------------------------------------------------------------------------------------------

-- A character above ASCII: not in one of the ranges, which rise.
local function is_printable(code)
    local ranges = profile.unprintable
    local first, behind = 0, #ranges / 2
    while first < behind do
        local middle = math.floor((first + behind) / 2)
        if ranges[2 * middle + 2] < code then
            first = middle + 1
        else
            behind = middle
        end
    end
    return first == #ranges / 2 or code < ranges[2 * first + 1]
end

-- Number of bytes of the UTF-8 character at a place of a string, and its code; nil if there is none.
local function utf8_at(text, at)
    local first = text:byte(at)
    local length, code, least
    if first >= 0xC2 and first <= 0xDF then
        length, code, least = 2, first - 0xC0, 0x80
    elseif first >= 0xE0 and first <= 0xEF then
        length, code, least = 3, first - 0xE0, 0x800
    elseif first >= 0xF0 and first <= 0xF4 then
        length, code, least = 4, first - 0xF0, 0x10000
    else
        return nil
    end
    for place = at + 1, at + length - 1 do
        local byte = text:byte(place)
        if not byte or byte < 0x80 or byte > 0xBF then
            return nil
        end
        code = code * 64 + byte - 0x80
    end
    if code < least or code > 0x10FFFF or (code >= 0xD800 and code <= 0xDFFF) then
        return nil
    end
    return length, code
end

-- The text of bytes: what is not printable is \xNN.
local function escaped(text)
    local parts, at = {}, 1
    while at <= #text do
        local byte, length = text:byte(at), 1
        local part
        if byte == 0x5C then
            part = "\\\\"
        elseif byte >= 0x20 and byte < 0x7F then
            part = string.char(byte)
        elseif byte >= 0x80 then
            local code
            length, code = utf8_at(text, at)
            if length and is_printable(code) then
                part = text:sub(at, at + length - 1)
            end
            length = length or 1
        end
        if not part then
            part = ""
            for place = at, at + length - 1 do
                part = part .. string.format("\\x%02X", text:byte(place))
            end
        end
        parts[#parts + 1] = part
        at = at + length
    end
    return table.concat(parts)
end

-- Identifier ------------------------------------------------------------------------------------

local function bits(number, low, count)
    return math.floor(math.floor(number / 2 ^ low) % 2 ^ count)
end

local types = {
    [0] = "REQ_CC_TGT", [1] = "REQ_CC_BCST", [2] = "RSP_CC_TGT", [3] = "RSP_CC_UNSC",
    [4] = "REQ_CU_TGT", [5] = "REQ_CU_BCST", [10] = "RSP_CU_TGT", [11] = "RSP_CU_UNSC",
}

local function header_of(id)
    local header = {
        flags = bits(id, 25, 4),
        err = bits(id, 24, 1) == 1,
        src = bits(id, 17, 7),
        dst = bits(id, 10, 7),
        srv = bits(id, 0, 10),
    }
    header.u = bits(id, 28, 1) == 1
    header.d = bits(id, 27, 1) == 1
    header.r = bits(id, 26, 1) == 1
    header.b = bits(id, 25, 1) == 1
    header.type = types[header.flags] or "NONCONFORMING"
    if header.flags == 15 and header.err then
        header.type = "DEBUG"
    end
    header.conforms = header.type ~= "NONCONFORMING"
        and (header.type ~= "DEBUG" or header.dst == 127)
    header.failed = header.r and not header.err and header.conforms
    return header
end

-- ISO 15765-2 -----------------------------------------------------------------------------------

-- The protocol control information of a frame; nil and the reason if there is none.
local function pci_of(data, is_fd)
    local first = data:byte(1)
    if not first then
        return nil, "empty frame"
    end
    local high, low = bits(first, 4, 4), bits(first, 0, 4)
    local wrong = "a length that does not fit the frame"
    if high == 0 then
        local length, from = low, 2
        if low == 0 then
            length, from = is_fd and data:byte(2) or 0, 3
        end
        if length == 0 or #data < from + length - 1 then
            return nil, wrong
        end
        return { kind = "single", length = length, message = data:sub(from, from + length - 1) }
    elseif high == 1 then
        if #data < 2 then
            return nil, wrong
        end
        local length, from = low * 256 + data:byte(2), 3
        if length == 0 then
            if #data < 6 then
                return nil, wrong
            end
            local a, b, c, d = data:byte(3, 6)
            length, from = ((a * 256 + b) * 256 + c) * 256 + d, 7
        end
        return { kind = "first", length = length, message = data:sub(from) }
    elseif high == 2 then
        return { kind = "consecutive", sequence = low, message = data:sub(2) }
    elseif high == 3 then
        local status = ({ [0] = "continue", [1] = "wait", [2] = "overflow" })[low]
        if not status then
            return nil, "an unknown frame type"
        elseif #data < 3 then
            return nil, wrong
        end
        return { kind = "flow control", status = status, block_size = data:byte(2),
            st_min = data:byte(3) }
    end
    return nil, "an unknown frame type"
end

-- DES -------------------------------------------------------------------------------------------

local max_message, max_services = 4095, 256

local function is_response_type(byte)
    return byte == 1 or byte == 2
end

local function response_framing(data, is_fd)
    local first = data:byte(1)
    if not first then
        return nil
    end
    local is_isotp = false
    if first == 0 then
        local length = data:byte(2)
        is_isotp = is_fd and is_response_type(data:byte(3)) and length + 2 <= #data
    elseif first <= 7 then
        is_isotp = #data > first and is_response_type(data:byte(2))
    elseif first >= 0x10 and first <= 0x3F then
        is_isotp = true
    end
    if is_isotp then
        return "isotp"
    end
    return is_response_type(first) and "raw" or nil
end

-- Place behind so many strings that end with zero; nil if there are fewer.
local function after_strings(body, at, count)
    for _ = 1, count do
        local zero = body:find("\0", at, true)
        if not zero then
            return nil
        end
        at = zero + 1
    end
    return at
end

local function fits_fixed(body, strings)
    local at, count = 1, 0
    while at <= #body do
        if count >= max_services or body:byte(at) ~= count then
            return false
        end
        at = after_strings(body, at + 1, strings)
        if not at then
            return false
        end
        count = count + 1
    end
    return count >= 2
end

-- End of the strings of the service whose strings begin here.
local function linear_end(body, from, following)
    local at = after_strings(body, from, 2)
    if not at then
        return #body + 1
    end
    while at <= #body do
        if body:byte(at) == following and after_strings(body, at + 1, 2) then
            return at
        end
        at = after_strings(body, at, 1)
        if not at then
            return #body + 1
        end
    end
    return at
end

local function split_strings(text)
    local strings = {}
    if text == "" then
        return strings
    end
    text = text:sub(-1) == "\0" and text:sub(1, -2) or text
    local at = 1
    while true do
        local zero = text:find("\0", at, true)
        strings[#strings + 1] = text:sub(at, (zero or #text + 1) - 1)
        if not zero then
            return strings
        end
        at = zero + 1
    end
end

-- The services of a response, and what is wrong with it.
local function services_of(message)
    if #message > max_message then
        return {}, "more than 4095 bytes"
    end
    local body = message:sub(2)
    if #body > 0 and body:byte(1) ~= 0 then
        return {}, "service index out of order"
    end
    local fixed
    for strings = 2, 8 do
        if fits_fixed(body, strings) then
            fixed = strings
            break
        end
    end
    local services, at, last = {}, 1, nil
    while at <= #body do
        local stop
        if fixed then
            stop = after_strings(body, at + 1, fixed)
        else
            stop = linear_end(body, at + 1, (#services + 1) % 256)
        end
        last = body:sub(at + 1, stop - 1)
        services[#services + 1] = { index = #services % 256, strings = split_strings(last) }
        at = stop
    end
    if #services > max_services then
        return {}, "more than 256 services"
    end
    if last and not fixed and (last:sub(-1) ~= "\0" or #services[#services].strings < 2) then
        return services, "truncated"
    end
    return services, nil
end

-- A raw message without its padding.
local function without_padding(data)
    local first, last = data:byte(1), data:byte(-1)
    if first == 1 then
        local zero = data:find("\0", 2, true)
        return zero and data:sub(1, zero) or data
    elseif first == 2 and #data > 1 then
        if last == 0x55 or last == 0xAA or last == 0xCC or last == 0xFF then
            local stop = #data
            while stop > 1 and data:byte(stop) == last do
                stop = stop - 1
            end
            return data:sub(1, stop)
        elseif last == 0 then
            local stop = #data
            while stop > 0 and data:byte(stop) == 0 do
                stop = stop - 1
            end
            for place = stop, #data - 1 do
                local message = data:sub(1, place)
                local _, fault = services_of(message)
                if message ~= "" and not fault then
                    return message
                end
            end
        end
    end
    return data
end

local function name_of(message)
    if #message > max_message then
        return "", "more than 4095 bytes"
    end
    local zero = message:find("\0", 2, true)
    if not zero then
        return message:sub(2), "truncated"
    end
    return message:sub(2, zero - 1), zero < #message and "bytes after the name" or nil
end

local function request_text(found, message)
    if #message ~= 4 then
        found.fault = "not a DES request"
        return found.fault
    end
    found.request = message:byte(4)
    if found.request == 1 then
        return "name request"
    elseif found.request == 2 then
        return "services request"
    end
    return string.format("reserved DES request %02X", found.request)
end

-- The meaning of a whole response.
local function response_text(found, message)
    local text
    if message:byte(1) == 1 then
        found.name, found.fault = name_of(message)
        text = "name " .. escaped(found.name)
    elseif message:byte(1) == 2 then
        found.services, found.fault = services_of(message)
        local parts = {}
        for _, service in ipairs(found.services) do
            local name, version = service.strings[1] or "", service.strings[2] or ""
            parts[#parts + 1] = escaped(name) .. " " .. escaped(version)
        end
        text = "services: " .. (#parts > 0 and table.concat(parts, ", ") or "none")
    else
        found.fault = "not a DES response"
        return found.fault
    end
    return found.fault and text .. " (" .. found.fault .. ")" or text
end

local function is_request(message)
    return message:sub(1, 3) == "DES"
end

local function des_request(found, data, is_fd)
    if is_request(data) and #data >= 4 then
        found.framing = "raw"
        return request_text(found, data:sub(1, 4)) .. ", raw"
    end
    local pci = pci_of(data, is_fd)
    if pci and pci.kind == "single" and is_request(pci.message) then
        found.framing, found.pci = "isotp", pci
        return request_text(found, pci.message)
    elseif pci and pci.kind == "flow control" then
        found.framing, found.pci = "isotp", pci
        return "flow control: " .. pci.status
    end
    found.fault = "not a DES request"
    return found.fault
end

-- Transfers that are open, by interface and identifier.
local transfers = {}

-- N_Cr: longest wait for the next frame of a transfer, in seconds.
local n_cr = 1

local function reassemble(found, key, time)
    local pci = found.pci
    if pci.kind == "first" then
        transfers[key] = nil
        if pci.length <= max_message then
            transfers[key] =
                { length = pci.length, message = pci.message, sequence = 1, time = time }
        end
    elseif pci.kind == "consecutive" and transfers[key] then
        local open = transfers[key]
        if pci.sequence ~= open.sequence or time - open.time > n_cr then
            transfers[key] = nil
            return
        end
        open.time = time
        open.message = open.message .. pci.message
        open.sequence = (open.sequence + 1) % 16
        if #open.message >= open.length then
            transfers[key] = nil
            found.message = open.message:sub(1, open.length)
            response_text(found, found.message)
        end
    end
end

local function des_response(found, data, is_fd, key, time)
    found.framing = response_framing(data, is_fd)
    if found.framing == "raw" then
        found.message = without_padding(data)
        return response_text(found, found.message)
    elseif not found.framing then
        found.fault = "neither ISO-TP nor raw"
        return found.fault
    end
    local pci, fault = pci_of(data, is_fd)
    if not pci then
        found.fault = fault
        return fault
    end
    found.pci = pci
    if pci.kind == "single" then
        found.message = pci.message
        return response_text(found, pci.message)
    elseif pci.kind == "flow control" then
        return "flow control: " .. pci.status
    end
    reassemble(found, key, time)
    if pci.kind == "first" then
        local what = ({ "name", "services" })[pci.message:byte(1)] or "message"
        return string.format("first frame: %s, %d bytes", what, pci.length)
    end
    return string.format("consecutive frame %X", pci.sequence)
end

-- Heartbeat -------------------------------------------------------------------------------------

local function uid_text(bytes)
    if bytes == ("\0"):rep(6) or bytes == ("\255"):rep(6) then
        return nil
    end
    local number, text = 0, {}
    for place = 1, 6 do
        number = number * 256 + bytes:byte(place)
    end
    for place = 8, 1, -1 do
        text[place] = profile.alphabet[number % 64 + 1]
        number = math.floor(number / 64)
    end
    return (escaped(table.concat(text)):gsub(" +$", ""))
end

local function byte_of(data, offset)
    return offset and data:byte(offset + 1)
end

local function heartbeat(found, data)
    local text = "heartbeat"
    found.mode = profile.modes[byte_of(data, profile.mode_offset)]
    if found.mode then
        text = text .. " " .. found.mode
    end
    local offset = profile.uid_offset
    if offset and #data >= offset + 6 then
        found.uid = uid_text(data:sub(offset + 1, offset + 6))
        if found.uid then
            text = text .. " " .. found.uid
        end
    end
    found.error_code = byte_of(data, profile.error_offset)
    if (found.error_code or 0) ~= 0 then
        text = text .. " error " .. found.error_code
    end
    return text
end

-- Data of services ------------------------------------------------------------------------------

-- A number with at most so many significant digits; with an exponent where it is far from 1.
local function number_text(number, digits)
    if number ~= number then
        return "NaN"
    end
    -- Not a number in Lua: "inf", also of one that is too large when rounded.
    local rounded = tonumber(string.format("%." .. digits - 1 .. "e", number))
    if not rounded or math.abs(rounded) == math.huge then
        return number > 0 and "inf" or "-inf"
    end
    local text
    for decimals = 0, digits - 1 do
        text = string.format("%." .. decimals .. "e", rounded)
        if tonumber(text) == rounded then
            break
        end
    end
    local sign, first, rest, exponent = text:match("^(-?)(%d)%.?(%d*)e([-+]%d+)$")
    local all = (first .. rest):gsub("0+$", "")
    exponent = tonumber(exponent)
    if all == "" then
        return sign .. "0"
    elseif exponent < -6 or exponent >= 15 then
        local fraction = #all > 1 and "." .. all:sub(2) or ""
        return sign .. all:sub(1, 1) .. fraction .. string.format("e%d", exponent)
    elseif exponent < 0 then
        return sign .. "0." .. ("0"):rep(-exponent - 1) .. all
    end
    local whole = all .. ("0"):rep(exponent + 1 - #all)
    local fraction = whole:sub(exponent + 2)
    return sign .. whole:sub(1, exponent + 1) .. (fraction ~= "" and "." .. fraction or "")
end

-- The bits of a number, and true if it is negative: then the bits are those of its magnitude.
local function integer_of(of, range, big_endian)
    local number = big_endian and range:uint64() or range:le_uint64()
    local surplus = 64 - of.bits
    number = number:rshift(of.low):lshift(surplus):rshift(surplus)
    if of.kind == "signed" and number:rshift(of.bits - 1):tonumber() == 1 then
        return (number:bnot() + UInt64(1)):lshift(surplus):rshift(surplus), true
    end
    return number, false
end

local function scaled_text(of, number)
    local value = number * of.scale + of.offset
    local text = of.decimals and string.format("%." .. of.decimals .. "f", value)
        or number_text(value, of.digits)
    return text, value
end

-- The text of a value, and its number if it has one; nil if the data are too short.
local function value_of(of, buffer, big_endian)
    local size = of.size or buffer:len() - of.at
    if size < 1 or of.at + size > buffer:len() then
        return nil
    end
    local range = buffer(of.at, size)
    if of.kind == "text" then
        local text = range:raw()
        return '"' .. escaped(text:sub(1, (text:find("\0", 1, true) or #text + 1) - 1)) .. '"'
    elseif of.kind == "bytes" then
        local byte = function(it) return string.format("%02X ", it:byte()) end
        return (range:raw():gsub(".", byte):sub(1, -2))
    elseif of.kind == "float" then
        local number = big_endian and range:float() or range:le_float()
        if of.scale then
            return scaled_text(of, number)
        end
        return number_text(number, of.digits), number
    end
    local magnitude, is_negative = integer_of(of, range, big_endian)
    local text = (is_negative and "-" or "") .. tostring(magnitude)
    local number = magnitude:tonumber() * (is_negative and -1 or 1)
    if of.values[text] then
        return of.values[text], number
    elseif of.kind == "bool" then
        return number ~= 0 and "yes" or "no", number
    elseif of.scale then
        return scaled_text(of, number)
    end
    return text, number
end

-- The fields of data, and their meaning in words.
local function data_fields(layout, buffer)
    local fields, words, last = {}, {}, 0
    for _, of in ipairs(layout) do
        local value, number = value_of(of, buffer, layout.big_endian)
        local text = of.name .. " " .. (value or "–")
        if value and of.unit then
            text = text .. " " .. of.unit
        end
        words[#words + 1] = text
        fields[#fields + 1] =
            { text = text, name = of.name, value = value, number = number, unit = of.unit }
        last = math.max(last, of.size and of.at + of.size or buffer:len())
    end
    if last < buffer:len() then
        local byte = function(it) return string.format(" %02X", it:byte()) end
        words[#words + 1] = "+" .. buffer:raw(last):gsub(".", byte)
    end
    return fields, table.concat(words, ", ")
end

-- Frame -----------------------------------------------------------------------------------------

-- Names of devices, by interface and address, from the responses of the capture so far.
local names = {}
-- What was found in each frame: transfers and names depend on the frames before.
local frames = {}

function candes.init()
    transfers, names, frames = {}, {}, {}
end

-- `server_name`: name of the device that serves, or sends.
local function service_name(header, server_name)
    local of_type = profile.types[server_name or ""] or profile.common
    if header.type == "DEBUG" then
        return profile.debug_names[header.srv] or of_type.debug[header.srv]
            or profile.common.debug[header.srv]
    end
    return profile.services[header.srv] or of_type.services[header.srv]
        or profile.common.services[header.srv]
end

-- The fields of the data of a frame of a service, or of the parameters of a DEBUG message; nil if they
-- are not known.
local function layout_of(header, server_name)
    local part
    if header.type == "DEBUG" then
        part = "parameters"
    elseif not header.r then
        part = "request"
    else
        part = header.b and "data" or "response"
    end
    local of_type = profile.types[server_name or ""] or profile.common
    return of_type[part][header.srv] or profile.common[part][header.srv]
end

-- The name of a service in the types of the devices on a bus so far, if they agree.
local function agreed_name(bus, srv)
    local agreed
    for key, name in pairs(names) do
        local of_type = key:find(bus .. ":", 1, true) == 1 and profile.types[name]
        local own = of_type and of_type.services[srv]
        if own and agreed and own ~= agreed then
            return nil
        end
        agreed = own or agreed
    end
    return agreed
end

-- The name of the device that serves, or sends.
local function server_name(header, bus)
    if header.r then
        return names[bus .. ":" .. header.src]
    end
    return not header.b and names[bus .. ":" .. header.dst] or nil
end

local function analyse(header, buffer, is_fd, bus, time)
    local found = {}
    local own = bus .. ":" .. header.src
    local data = buffer:len() > 0 and buffer:raw() or ""
    if header.type == "DEBUG" then
        local name = service_name(header, names[own])
        found.text = "debug message " .. (name or string.format("0x%03X", header.srv))
        local layout = layout_of(header, names[own])
        if layout then
            local words
            found.fields, words = data_fields(layout, buffer)
            found.text = found.text .. ": " .. words
        end
    elseif header.srv == profile.heartbeat and header.r then
        found.text = heartbeat(found, data)
    elseif header.srv == profile.des and header.r then
        found.text = des_response(found, data, is_fd, bus .. ":" .. header.id, time)
    elseif header.srv == profile.des then
        found.text = des_request(found, data, is_fd)
    else
        found.text = ""
        local layout = not header.failed and header.conforms
            and layout_of(header, server_name(header, bus))
        if layout then
            found.fields, found.text = data_fields(layout, buffer)
        end
    end
    if header.failed then
        found.text = found.text == "" and "error" or "error: " .. found.text
    end
    if (found.name or "") ~= "" and not header.failed and header.conforms then
        names[own] = found.name
    end
    local source, receiver = names[own], nil
    if not header.b then
        receiver = names[bus .. ":" .. header.dst]
    end
    found.src_name = source and escaped(source)
    found.dst_name = receiver and escaped(receiver)
    found.service = service_name(header, server_name(header, bus))
    if not found.service and header.b and not header.r then
        found.service = agreed_name(bus, header.srv)
    end
    return found
end

local function add(tree, name, value)
    if value ~= nil then
        tree:add(field[name], value)
    end
end

local function show(tree, header, found)
    add(tree, "type", header.type)
    for _, name in ipairs({ "u", "d", "r", "b", "err", "src" }) do
        add(tree, name, header[name])
    end
    add(tree, "src_name", found.src_name)
    add(tree, "dst", header.dst)
    add(tree, "dst_name", found.dst_name)
    add(tree, "srv", header.srv)
    add(tree, "service", found.service)
    if found.text ~= "" then
        add(tree, "text", found.text)
    end
    for _, of in ipairs(found.fields or {}) do
        local branch = tree:add(field.field, of.text)
        add(branch, "field_name", of.name)
        add(branch, "field_value", of.value)
        add(branch, "field_number", of.number)
        add(branch, "field_unit", of.unit)
    end
    add(tree, "framing", found.framing)
    if found.pci then
        local pci = found.pci
        add(tree, "isotp.kind", pci.kind)
        add(tree, "isotp.length", pci.length)
        add(tree, "isotp.sequence", pci.sequence)
        add(tree, "isotp.block_size", pci.block_size)
        add(tree, "isotp.st_min", pci.st_min)
    end
    if found.message then
        local bytes = ByteArray.new()
        bytes:set_size(#found.message)
        for at = 1, #found.message do
            bytes:set_index(at - 1, found.message:byte(at))
        end
        tree:add(field["isotp.message"], bytes:tvb("DES message"):range())
    end
    add(tree, "request", found.request)
    add(tree, "name", found.name and escaped(found.name))
    for _, service in ipairs(found.services or {}) do
        local branch = tree:add(field.service_index, service.index)
        for at, text in ipairs(service.strings) do
            local names = { "service_name", "service_version" }
            add(branch, names[at] or "service_more", escaped(text))
        end
    end
    add(tree, "fault", found.fault)
    add(tree, "uid", found.uid)
    add(tree, "mode", found.mode)
    add(tree, "error_code", found.error_code)
    if found.fault then
        tree:add_proto_expert_info(malformed, found.fault)
    end
    if not header.conforms then
        tree:add_proto_expert_info(nonconforming)
    elseif header.failed and not header.b then
        tree:add_proto_expert_info(failed)
    end
end

local function label(address, name)
    return name and name .. " @" .. address or "@" .. address
end

local function dissect(buffer, pinfo, root)
    local id, is_extended, is_remote = can_id(), can_extended(), can_remote()
    if not id or not is_extended or not is_extended.value or (is_remote and is_remote.value) then
        return 0
    end
    local header = header_of(id.value)
    header.id = id.value
    local found = frames[pinfo.number]
    if not found then
        local bus = interface()
        bus = bus and bus.value or 0
        found = analyse(header, buffer, canfd_rate() ~= nil, bus, tonumber(tostring(pinfo.rel_ts)))
        frames[pinfo.number] = found
    end
    local tree = root:add(candes, buffer())
    show(tree, header, found)
    local service = found.service or string.format("0x%03X", header.srv)
    local meaning = found.text ~= "" and found.text or header.type
    pinfo.cols.protocol = "CAN DES"
    pinfo.cols.src = label(header.src, found.src_name)
    pinfo.cols.dst = header.b and "*" or label(header.dst, found.dst_name)
    pinfo.cols.info = service .. " " .. meaning
    return buffer:len()
end

function candes.dissector(buffer, pinfo, root)
    return dissect(buffer, pinfo, root)
end

candes:register_heuristic("can", function(buffer, pinfo, root)
    return dissect(buffer, pinfo, root) > 0 or frames[pinfo.number] ~= nil
end)
