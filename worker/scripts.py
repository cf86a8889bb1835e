"""The Lua scripts that keep the index: each is one atomic step.

Job: lease, commit, renew, expire, rebuild, cancel.
Invariant: a lease belongs to a worker, a worker has one lease; a done bit is never cleared but by REDO, and `done` is
the number of set bits; a script that finds the index wiped changes nothing. Doing any of them twice is harmless.
"""

from worker import contract as c

# Put tile ARGV-like `job`, `tile` back for others, if it is still wanted; shared by the scripts that end a lease.
_GIVE_BACK = f"""
local function give_back(lease)
  local job, tile = string.match(lease, '^(.*)/(.+)$')
  if tile == 'p' then
    redis.call('HDEL', '{c.KEY_PREPARING}', job)
  elseif redis.call('EXISTS', '{c.KEY_JOB}'..job) == 1 and redis.call('GETBIT', '{c.KEY_DONE}'..job, tile) == 0 then
    redis.call('SADD', '{c.KEY_RETRY}'..job, tile)
  end
  return job, tile
end
local function end_lease(who)
  local lease = redis.call('HGET', '{c.KEY_LEASES}', who)
  redis.call('ZREM', '{c.KEY_DEADLINES}', who)
  redis.call('HDEL', '{c.KEY_LEASES}', who)
  if lease then return lease, give_back(lease) end
end
"""

_DEADLINE = """
local function deadline(ttl)
  local t = redis.call('TIME')
  return t[1] * 1000 + math.floor(t[2] / 1000) + tonumber(ttl)
end
"""

# ARGV: epoch, job, worker, ttl ms (0: commit only), finished tile or -1, rays, kernel microseconds.
# Returns {tile or -1, done, n}; {-3} wrong epoch; {-2} unknown job.
NEXT = f"""{_GIVE_BACK}{_DEADLINE}
if redis.call('GET', '{c.KEY_EPOCH}') ~= ARGV[1] then return {{-3}} end
local job, who, tile = ARGV[2], ARGV[3], tonumber(ARGV[5])
local j, b, r = '{c.KEY_JOB}'..job, '{c.KEY_DONE}'..job, '{c.KEY_RETRY}'..job
local h = redis.call('HMGET', j, 'n', 'next', 'done', 'state', 'cols')
if not h[1] then return {{-2}} end
local n, nx, done, cols = tonumber(h[1]), tonumber(h[2]), tonumber(h[3]), tonumber(h[5])
local dirty = false
if tile >= 0 and redis.call('SETBIT', b, tile, 1) == 0 then
  done = done + 1
  dirty = true
  redis.call('HINCRBY', j, 'rays', ARGV[6])
  redis.call('HINCRBY', j, 'kernel_us', ARGV[7])
  -- Only a complete row of tiles is news for the assembler; the last tile always completes one.
  local first = tile - tile % cols
  if redis.call('BITCOUNT', b, first, first + cols - 1, 'BIT') == cols then
    redis.call('PUBLISH', '{c.CHANNEL_ASSEMBLER}', job)
  end
end
-- A lease other than the finished one is a reply that never arrived: its tile must not be lost.
local held = redis.call('HGET', '{c.KEY_LEASES}', who)
if held and held ~= job..'/'..tile then give_back(held) end
local got = -1
if h[4] == 'r' and tonumber(ARGV[4]) > 0 then
  repeat  -- retries first: a lost tile must not wait for the whole job
    local t = redis.call('SPOP', r)
    if t and redis.call('GETBIT', b, t) == 0 then got = tonumber(t) end
  until not t or got >= 0
  if got < 0 and nx < n then  -- then the cursor; BITPOS skips a long done prefix after a rebuild
    local t = redis.call('BITPOS', b, 0, nx, -1, 'BIT')
    if t < 0 then t = math.max(nx, redis.call('STRLEN', b) * 8) end
    if t < n then got = t end
    nx = math.min(t, n - 1) + 1
    dirty = true
  end
end
if dirty then redis.call('HSET', j, 'next', nx, 'done', done) end
if got >= 0 then
  redis.call('HSET', '{c.KEY_LEASES}', who, job..'/'..got)
  redis.call('ZADD', '{c.KEY_DEADLINES}', deadline(ARGV[4]), who)
elseif held then
  redis.call('HDEL', '{c.KEY_LEASES}', who)
  redis.call('ZREM', '{c.KEY_DEADLINES}', who)
end
return {{got, done, n}}
"""

# ARGV: epoch, job, worker, ttl ms. Returns 1 if the worker now prepares the job, 0 if another does, -3 wrong epoch.
PREPARE = f"""{_GIVE_BACK}{_DEADLINE}
if redis.call('GET', '{c.KEY_EPOCH}') ~= ARGV[1] then return -3 end
local owner = redis.call('HGET', '{c.KEY_PREPARING}', ARGV[2])
if owner and owner ~= ARGV[3] and redis.call('ZSCORE', '{c.KEY_DEADLINES}', owner) then return 0 end
local held = redis.call('HGET', '{c.KEY_LEASES}', ARGV[3])
if held and held ~= ARGV[2]..'/p' then give_back(held) end
redis.call('HSET', '{c.KEY_PREPARING}', ARGV[2], ARGV[3])
redis.call('HSET', '{c.KEY_LEASES}', ARGV[3], ARGV[2]..'/p')
redis.call('ZADD', '{c.KEY_DEADLINES}', deadline(ARGV[4]), ARGV[3])
return 1
"""

# ARGV: worker. Ends its lease, if any, giving the tile back; returns the lease "job/tile" or nil.
RELEASE = f"""{_GIVE_BACK}
local lease = end_lease(ARGV[1])
return lease or false
"""

# ARGV: ttl ms, workers... Returns those whose lease is gone.
RENEW = f"""{_DEADLINE}
local until_ms, lost = deadline(ARGV[1]), {{}}
for i = 2, #ARGV do
  if redis.call('ZSCORE', '{c.KEY_DEADLINES}', ARGV[i]) then
    redis.call('ZADD', '{c.KEY_DEADLINES}', until_ms, ARGV[i])
  else
    lost[#lost + 1] = ARGV[i]
  end
end
return lost
"""

# ARGV: most to expire. Returns {epoch or '', server's run id, "worker job/tile"...}: one call tells the janitor all.
EXPIRE = f"""{_GIVE_BACK}{_DEADLINE}
local run = string.match(redis.call('INFO', 'server'), 'run_id:(%x+)')
local out = {{redis.call('GET', '{c.KEY_EPOCH}') or '', run or ''}}
for _, who in ipairs(redis.call('ZRANGEBYSCORE', '{c.KEY_DEADLINES}', '-inf', deadline(0), 'LIMIT', 0, ARGV[1])) do
  local lease, job, tile = end_lease(who)
  if lease then out[#out + 1] = who..' '..lease end
end
return out
"""

# ARGV: job, n, columns, state (r|c), done bits. Adds the job, or adds done bits to it; never takes any away.
INIT = f"""
local job = ARGV[1]
local j, b, fresh = '{c.KEY_JOB}'..job, '{c.KEY_DONE}'..job, '{c.KEY_DONE}'..job..':new'
redis.call('SET', fresh, ARGV[5])
redis.call('BITOP', 'OR', b, b, fresh)
redis.call('DEL', fresh)
local done = redis.call('BITCOUNT', b)
local is_new = redis.call('EXISTS', j) == 0
if is_new then
  redis.call('HSET', j, 'n', ARGV[2], 'cols', ARGV[3], 'next', 0, 'done', done, 'state', ARGV[4],
    'rays', 0, 'kernel_us', 0)
else
  redis.call('HSET', j, 'done', done)
  if ARGV[4] == 'c' then redis.call('HSET', j, 'state', 'c') end
end
redis.call('SADD', '{c.KEY_ACTIVE}', job)
redis.call('PUBLISH', '{c.CHANNEL_ASSEMBLER}', job)
return is_new and 1 or 0
"""

# ARGV: job, tile. A tile's file was damaged and is gone: hand the tile out again.
REDO = f"""
local j, b = '{c.KEY_JOB}'..ARGV[1], '{c.KEY_DONE}'..ARGV[1]
if redis.call('EXISTS', j) == 0 then return 0 end
if redis.call('SETBIT', b, ARGV[2], 0) == 1 then redis.call('HINCRBY', j, 'done', -1) end
redis.call('SADD', '{c.KEY_RETRY}'..ARGV[1], ARGV[2])
return 1
"""

# ARGV: job. No more tiles of it are handed out, kernels that render it stop; returns how many leases it still has.
STOP = f"""
local job = ARGV[1]
if redis.call('EXISTS', '{c.KEY_JOB}'..job) == 1 then redis.call('HSET', '{c.KEY_JOB}'..job, 'state', 'c') end
redis.call('PUBLISH', '{c.CHANNEL_CONTROL}', 'cancel '..job)
local leases = 0
for _, lease in ipairs(redis.call('HVALS', '{c.KEY_LEASES}')) do
  if string.sub(lease, 1, #job + 1) == job..'/' then leases = leases + 1 end
end
return leases
"""

# ARGV: job. Removes the job from the index; leases of it die out by themselves (NEXT answers "unknown job").
FORGET = f"""
local job = ARGV[1]
redis.call('SREM', '{c.KEY_ACTIVE}', job)
redis.call('HDEL', '{c.KEY_PREPARING}', job)
return redis.call('DEL', '{c.KEY_JOB}'..job, '{c.KEY_DONE}'..job, '{c.KEY_RETRY}'..job, '{c.KEY_FAULTS}'..job)
"""

# ARGV: job, owner, ttl ms. Takes or renews the assembler's claim on a job: 1 if the owner has it now.
CLAIM = f"""
local key = '{c.KEY_CLAIM}'..ARGV[1]
local owner = redis.call('GET', key)
if owner and owner ~= ARGV[2] then return 0 end
redis.call('SET', key, ARGV[2], 'PX', ARGV[3])
return 1
"""

# ARGV: job, owner.
UNCLAIM = f"""
local key = '{c.KEY_CLAIM}'..ARGV[1]
if redis.call('GET', key) == ARGV[2] then return redis.call('DEL', key) end
return 0
"""
